"""The networks of the model."""
