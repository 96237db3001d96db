"""Using the model on photographs and clips."""
