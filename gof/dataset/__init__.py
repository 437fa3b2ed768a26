"""The on-disk dataset: `gof generate` and `gof ingest` write it, everything else reads it (docs/formats.md)."""

from gof.dataset.dataset import Dataset
from gof.dataset.description import CameraEntry, DatasetDescription, Splits, held_out

__all__ = ["CameraEntry", "Dataset", "DatasetDescription", "Splits", "held_out"]
