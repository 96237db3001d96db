"""Handing out subjects to workers. Variants differ only in how the work is handed out."""
