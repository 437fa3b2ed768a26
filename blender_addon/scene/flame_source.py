"""The source of a scene's flame; no other module knows more than one kind.

Rendering, cameras, effects of the pictures, truth, views and scores know a flame only as one object of the scene that
shines (`fire_objects.find_flame`), and as the methods below.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import bpy
import numpy as np

from ..pure.fires import Fire, GridFire
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from .grid_source import GridSource
from .mantaflow_source import MantaflowSource

SOURCES = {Fire: MantaflowSource, GridFire: GridSource}


class FlameSource(Protocol):
    """A flame from somewhere. Grids are (X, Y, Z) or (X, Y, Z, 3) float32 at cell centres of `index_to_world`.

    Attributes:
        contents: attributes of the scalar grids that are truth (`grid_writer.scalar`), by name.
        dtype: in which they are stored.
        index_to_world: (4, 4) continuous cell index (cell i spans [i, i + 1]) to world metres.
    """

    contents: dict[str, dict]
    dtype: str
    index_to_world: np.ndarray

    def build(self, collection: bpy.types.Collection) -> Any:
        """Add the flame to a collection of the open scene; nothing is made on disk. Returns what was added."""

    def bake(self, layout: Layout, progress: Callable[[int, int], None]) -> None:
        """Make in the empty `layout.bake` what every step needs; the open scene is saved as `layout.blend`."""

    def export_velocity(self, path: Path, progress: Callable[[int, int], None]) -> None:
        """Write the velocity of all dataset frames, resumable."""

    def velocity(self, blender_frame: int) -> np.ndarray:
        """Return velocity of the gas, m/s of the dataset clock, world axes."""

    def scalars(self, blender_frame: int) -> dict[str, np.ndarray]:
        """Scalar grids that there are, of those in `contents`; "flame" is always one."""

    def light(self, blender_frame: int) -> np.ndarray:
        """Return emitted light, up to one factor."""

    def provenance(self) -> dict[str, Any]:
        """Return the dataset's notes on the flame's origin beside its spec."""


def flame_source(spec: SceneSpec) -> FlameSource:
    """Return the source of a spec's flame. Its methods raise SpecError where the files of a fire of grids are wrong."""
    return SOURCES[type(spec.fire)](spec)
