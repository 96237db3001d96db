"""Datasets: their files, the shots in them, and reading them (`open_dataset`)."""

from synthgen.dataset.reading import Dataset, open_dataset
from synthgen.dataset.records import FORMAT, FORMATS, averaged, curve
from synthgen.dataset.samples import Samples, decoder

__all__ = [
    "FORMAT",
    "FORMATS",
    "Dataset",
    "Samples",
    "averaged",
    "curve",
    "decoder",
    "open_dataset",
]
