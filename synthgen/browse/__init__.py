"""`synthgen browse`: a local web page over a dataset, read by offset out of its tars.

The server reads, and writes nothing but tags: what the page shows comes from the manifest (`table`)
and from single members of shards (`shot`); `access` says who may ask.
"""
