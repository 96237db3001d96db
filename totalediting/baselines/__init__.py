"""What needs no training: the floors that a trained model must beat."""
