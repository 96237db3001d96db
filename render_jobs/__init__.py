"""The shipped jobs, one TOML file each: `synthgen jobs` lists them, `synthgen plan demo` takes one.

The comment that a file starts with says in its first sentence what the job is for.
"""
