"""A flame that we simulate: Mantaflow's domain is the flame, its cache what the steps need."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..core.grid_writer import scalar
from ..pure.effects import beyond_velocity
from ..pure.layout import Layout
from ..pure.soot import within_cells
from ..pure.spec import SceneSpec
from . import fire, material, velocity
from .fire_objects import FireObjects, find_flame

QUANTITIES = {"flame": "flame_grid", "heat": "heat_grid", "density": "density_grid"}
"""Names of scalar grids and their attributes in Blender. flame is the reaction, 0 to 1; heat and density are in the
solver's units. For a flame that glows by its soot it is the light of a metre, mean over colours and cell."""


class MantaflowSource:
    """See `flame_source.FlameSource`; scalars are on the coarse grid also where fine noise adds detail."""

    dtype = "float16"

    def __init__(self, spec: SceneSpec):
        self._spec = spec
        self.contents = {name: scalar(name) for name in QUANTITIES}
        # With soot the flame grid is the light itself, as in a fire of grids: no power of the reaction is its light.
        glows = spec.fire.dims
        self.contents["flame"] = scalar("flame", "linear scene radiance per metre") if glows else scalar("flame")
        self.contents["flame"]["light_exponent"] = 1.0 if glows else material.FLAME_EXPONENT

    def build(self, collection: bpy.types.Collection) -> FireObjects:
        objects = fire.build(self._spec, collection)
        fire.keep_for_dataset(objects.domain_settings)
        return objects

    def bake(self, layout: Layout, progress: Callable[[int, int], None]) -> None:
        needed = self._spec.timeline.steps_needed

        def simulated() -> int:
            layout.prune_bake(needed)
            return layout.newest_step()

        with Watch(simulated, needed[-1], progress):
            fire.bake(find_flame(), needed, layout.newest_step())

    @cached_property
    def index_to_world(self) -> np.ndarray:
        bpy.context.scene.frame_set(self._spec.timeline.first_frame)
        return velocity.index_to_world(find_flame())

    def export_velocity(self, path: Path, progress: Callable[[int, int], None]) -> None:
        spec = self._spec
        frames = [spec.timeline.blender_frame(frame) for frame in range(spec.clip.frames)]
        per_second, scale = spec.timeline.steps_per_second, spec.clip.time_scale
        velocity.export_velocity(find_flame(), frames, per_second, scale, path, progress)

    def velocity(self, blender_frame: int) -> np.ndarray:
        bpy.context.scene.frame_set(blender_frame)
        domain = find_flame()
        to_world = velocity.SOLVER_UNITS_PER_SECOND * self._spec.clip.time_scale * velocity.index_to_world(domain)
        return (velocity.cell_centred(velocity.read_staggered(domain)) @ to_world[:3, :3].T).astype(np.float32)

    def scalars(self, blender_frame: int) -> dict[str, np.ndarray]:
        bpy.context.scene.frame_set(blender_frame)
        found = dict(self._read_scalars())
        if self._spec.fire.dims:
            matrix = self.index_to_world
            height = matrix[2, 3] + matrix[2, 2] * (np.arange(found["flame"].shape[2]) + 0.5)
            height -= self._spec.fire.burner.bottom
            # Thin sheets are narrower than cells: their light is the mean over places in each.
            places = within_cells(found["flame"]) if self._spec.fire.light == "sheets" else found["flame"][None]
            light = sum(self._spec.fire.sheet.light(place, height) for place in places) / len(places)
            found["flame"] = light.astype(np.float32)
        return found

    def light(self, blender_frame: int) -> np.ndarray:
        return self.scalars(blender_frame)["flame"] ** self.contents["flame"]["light_exponent"]

    def provenance(self) -> dict[str, Any]:
        beyond = [
            name
            for name, effect in zip(self._spec.effect_names, self._spec.effects, strict=True)
            if beyond_velocity(effect)
        ]
        return {"not_in_velocity": ", ".join(beyond)} if beyond else {}

    def _read_scalars(self) -> Iterator[tuple[str, np.ndarray]]:
        settings = velocity.evaluated(find_flame())
        coarse = int(np.prod(settings.domain_resolution))
        for name, attribute in QUANTITIES.items():
            values = getattr(settings, attribute)
            if len(values):
                refine = round((len(values) / coarse) ** (1 / 3))
                fine = np.empty(len(values), np.float32)
                values.foreach_get(fine)
                x, y, z = settings.domain_resolution
                # Blender runs x fastest; blocks of fine noise are averaged.
                blocks = fine.reshape(z, refine, y, refine, x, refine).mean(axis=(1, 3, 5))
                yield name, blocks.transpose(2, 1, 0)


# ----------------------------------------------------------------
# Progress of a call that says nothing itself.


class Watch:
    """While a block keeps the main thread busy, reports count() of total, twice a second."""

    def __init__(self, count: Callable[[], int], total: int, progress: Callable[[int, int], None]):
        self._count = count
        self._total = total
        self._progress = progress
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._done.wait(0.5):
            self._progress(self._count(), self._total)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_) -> None:
        self._done.set()
        self._thread.join()
        self._progress(self._count(), self._total)
