"""What `gof reconstruct --preset preview` makes of a dataset up to the flow field that is seen, before any prior."""

from __future__ import annotations

from pathlib import Path

from gof.dataset import Dataset
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import VOXELS
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import Observation
from gof.reconstruct.presets import PRESETS
from gof.reconstruct.shrink import shrink

EFFORT = PRESETS["preview"]


def open_small(path: Path) -> Dataset:
    """The dataset in a folder, its pictures no larger than the preset's."""
    return shrink(Dataset.open(path), EFFORT.longest_side)


def preview_field(observation: Observation) -> FlowField:
    """The fused flow on the flow prior's voxels, m/s."""
    return seen_flow_field(observation, OURS, VOXELS)
