"""Networks that others trained: fetched by hash, read, computed."""
