"""Finished datasets: card, Croissant, licences, export, verification."""
