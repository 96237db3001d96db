"""Poses, expressions and their tracks over time."""
