"""Who may ask, how much, and how large a body may be."""
