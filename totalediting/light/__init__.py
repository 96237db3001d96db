"""Lightmaps and Phong shading."""
