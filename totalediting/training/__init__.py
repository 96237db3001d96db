"""Training in stages: loop, checkpoints, losses, metrics."""
