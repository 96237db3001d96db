"""How it is photographed: jobs, plan, Blender stage, shards, manifest, farm.

Importing this package imports nothing heavy; take what you need from its modules.
"""

__version__ = "0.2.0"
