"""Faces in photographs and clips: landmarks of others' networks, and the bust fitted to them."""
