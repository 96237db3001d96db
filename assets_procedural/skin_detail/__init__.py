"""What shows on the skin beyond the mesh: creases, marks and paint, as one picture."""
