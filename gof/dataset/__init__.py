"""The on-disk dataset: `gof generate` and `gof ingest` write it, everything else reads it (docs/formats.md)."""

from gof.core.description import CameraEntry, DatasetDescription, Splits, held_out
from gof.dataset.dataset import Dataset, open_dataset

__all__ = ["CameraEntry", "Dataset", "DatasetDescription", "Splits", "held_out", "open_dataset"]
