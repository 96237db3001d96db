"""Blender's room: put a person on the stage, pose, light, shoot. The only package with `bpy`."""
