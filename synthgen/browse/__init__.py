"""`synthgen browse`: a local web page over a dataset, read by offset out of its tars.

The server reads, and never writes: what the page shows comes from the manifest (`snapshot`,
`sandbox`, `selection`, `counts`) and from single members of shards (`samples`, `pictures`).
"""
