"""What exists: people, hair, skin, clothes and lights, as parameters and arrays. No Blender."""
