"""What exists: people, hair, skin, clothes and lights, as parameters and arrays. No Blender."""

__version__ = "0.2.0"
"""Of the three packages, which are released together."""
