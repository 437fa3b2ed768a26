"""The source of a scene's flame; no other module knows more than one kind.

Rendering, cameras, effects of the pictures, truth, views and scores know a flame only as one object of the scene that
shines (`fire_objects.find_flame`), and as the methods below.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import bpy
import numpy as np

from ..core.grid_writer import GridWriter, scalar
from ..pure.fires import Fire, GridFire
from ..pure.io import vdb_file
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from . import material
from .fire_objects import FLAME_NAME
from .mantaflow_source import MantaflowSource

EMISSION = "emission"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear Rec. 709, Blender's scene light


class GridSource:
    """See `flame_source.FlameSource`."""

    # The flame grid is the light itself: drawing from it takes no material (`gof.evaluate.emission`).
    contents = {"flame": {**scalar("flame", "linear scene radiance per metre"), "light_exponent": 1.0}}
    dtype = "float32"  # a solver's light has no usual size

    def __init__(self, spec: SceneSpec):
        self._spec, self._fire = spec, spec.fire

    def build(self, collection: bpy.types.Collection) -> bpy.types.Object:
        steps = self._spec.timeline.steps_needed
        volume = bpy.data.volumes.new(FLAME_NAME)
        # The number in a file's name is that of its Blender frame, whatever the first.
        volume.filepath = f"//.cache/bake/{steps[0]:06d}.vdb"  # of Layout.step_grids
        volume.is_sequence = True
        volume.frame_start, volume.frame_duration, volume.frame_offset = steps[0], len(steps), steps[0] - 1
        volume.sequence_mode = "CLIP"
        volume.render.precision = "FULL"  # a solver's light has no usual size
        volume.render.clipping = 0.0
        volume.materials.append(material.emission_grid(EMISSION, self._fire.radiance))
        flame = bpy.data.objects.new(FLAME_NAME, volume)
        flame.location = self._fire.position
        collection.objects.link(flame)
        return flame

    def bake(self, layout: Layout, progress: Callable[[int, int], None]) -> None:
        self._fire.require_clock(self._spec.timeline)
        steps = self._spec.timeline.steps_needed
        for done, step in enumerate(steps, 1):
            content, matrix = {EMISSION: self._emission(step)}, self._fire.store.index_to_world
            vdb_file.write(layout.step_grids(step), content, matrix, for_cycles=True)
            progress(done, len(steps))

    @cached_property
    def index_to_world(self) -> np.ndarray:
        matrix = self._fire.store.index_to_world.copy()
        matrix[:3, 3] += self._fire.position
        return matrix

    def export_velocity(self, path: Path, progress: Callable[[int, int], None]) -> None:
        clip, store = self._spec.clip, self._fire.store
        times, dtype = np.arange(clip.frames) / clip.fps, store.velocity.dtype.name
        writer = GridWriter(path, store.grid, self.index_to_world, times, store.cell_m, dtype)
        for frame in range(clip.frames):
            if not writer.has_frame(frame):
                writer.write_frame(frame, self.velocity(self._spec.timeline.blender_frame(frame)).__getitem__)
            progress(frame + 1, clip.frames)
        writer.finish()

    def velocity(self, blender_frame: int) -> np.ndarray:
        return self._fire.store.velocity.cells_at(self._time_s(blender_frame)) * np.float32(self._spec.clip.time_scale)

    def scalars(self, blender_frame: int) -> dict[str, np.ndarray]:
        return {"flame": self.light(blender_frame)}

    def light(self, blender_frame: int) -> np.ndarray:
        return np.float32(self._fire.radiance) * (self._emission(blender_frame) @ LUMINANCE)

    def provenance(self) -> dict[str, Any]:
        fire = self._fire.store.description
        return {"fire": {key: getattr(fire, key) for key in ("name", "solver", "seed", "emission_law")}}

    def _emission(self, blender_frame: int) -> np.ndarray:
        return np.maximum(self._fire.store.emission.cells_at(self._time_s(blender_frame)), 0.0)

    def _time_s(self, blender_frame: int) -> float:
        return self._fire.start_s + self._spec.timeline.simulated_s(blender_frame)


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
