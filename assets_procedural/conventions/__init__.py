"""One home for each convention: colour, cameras, panoramas, how files are written."""
