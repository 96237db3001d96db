"""The bust and what belongs to it: skin, eyes, mouth, landmarks."""
