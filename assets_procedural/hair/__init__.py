"""Hair on the scalp and in the face, strand by strand."""
