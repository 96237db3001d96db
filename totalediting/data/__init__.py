"""What models train on: shots, pairs, portraits, clips."""
