"""The manifest as a table that the page searches: sandboxed, encoded, selected, counted."""
