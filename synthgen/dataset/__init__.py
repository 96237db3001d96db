"""Datasets: their files, the shots in them, and reading them (`open_dataset`)."""

from synthgen.dataset.reading import Dataset, open_dataset

__all__ = ["Dataset", "open_dataset"]
