"""Vectors and surfaces: subdivision, sweeps."""
