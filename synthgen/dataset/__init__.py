"""Datasets: their files, the shots in them, and reading them (`open_dataset`)."""

from synthgen.dataset.reading import Dataset, open_dataset
from synthgen.dataset.records import FORMAT

__all__ = ["FORMAT", "Dataset", "open_dataset"]
