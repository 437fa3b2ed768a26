"""The cost of a dataset on this machine, before it is made: a small linear model with measured coefficients.

    bake     start + steps * a * cells^p, of a fire of grids start + steps * f * cells
    picture  b + pixels * (c + samples * (d + e * resolution))        the flame is marched in steps of a cell
    velocity start + frames * f * cells

`gof generate --estimate` measures the coefficients and keeps them for this user; without that they are those of another
machine. notebook/costs.md compares predictions with runs.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ..core import time_left
from ..core.checked_json import SpecError
from ..core.errors import GofError
from ..core.records import read_record, write_record
from ..core.time_left import LEAST_S, Paces, duration
from .spec import SceneSpec

# Measured on Blender 4.5, see notebook/costs.md.
BAKE_MB, BAKE_BYTES_PER_CELL = 260.0, 270.0
RENDER_MB, RENDER_BYTES_PER_CELL, RENDER_BYTES_PER_PIXEL = 330.0, 60.0, 700.0
CACHE_BYTES_PER_CELL_STEP, STATE_BYTES_PER_CELL, VELOCITY_BYTES_PER_CELL_FRAME = 15.5, 40.0, 6.0
PICTURE_BYTES_PER_PIXEL = 10.0
NOISE_BAKE, NOISE_MEMORY = 0.22, 0.3  # of the coarse bake, per fine cell that a coarse cell is divided into
CORES = os.cpu_count() or 1
YEAR_S = 365 * 86400.0
LONGEST_S = YEAR_S
SMOKE_SAMPLE = 20  # times one without smoke: all lamps, through the soot; 6 where it has begun, 24 in a full domain
LEARNED_ERROR = 0.25  # of a machine whose own runs corrected the model (notebook/costs.md)
ROOM = 0.9  # share of the memory that a dataset may take: the system needs some
SOOT_PICTURE = 2.3  # a flame of soot, over one that absorbs nothing: finer steps, and its cover rendered beside it


@dataclass(frozen=True)
class Machine:
    """Coefficients of the model, CPU seconds over cores.

    Attributes:
        error: relative prediction error that was measured with them.
        measured_on: name and date, for people.
    """

    SCHEMA: ClassVar[str] = "gof-machine"
    VERSION: ClassVar[int] = 1

    start: float
    bake_scale: float
    bake_power: float
    picture: float
    pixel: float
    sample: float
    sample_per_cell: float
    velocity: float
    error: float
    measured_on: str


REFERENCE = Machine(0.8, 4.5e-7, 1.13, 0.05, 1.5e-6, 1.8e-6, 0.0, 1.2e-7, 1.0, "another machine")
"""Two cores of a cloud server; for machines that have not been measured."""


@dataclass(frozen=True)
class Prediction:
    """CPU seconds per stage divided by the cores; their sum is the wall time where all cores are busy, as they
    are but for the start and the end: pictures are rendered during the bake. A machine with other work takes longer."""

    bake_s: float
    render_s: float
    ground_truth_s: float
    memory_mb: float
    disk_mb: float
    error: float
    measured_on: str

    @property
    def by_stage(self) -> dict[str, float]:
        """Return seconds by the stages that cost most."""
        return {"bake": self.bake_s, "render": self.render_s, "ground-truth": self.ground_truth_s}

    @property
    def total_s(self) -> float:
        return sum(self.by_stage.values())

    def __str__(self) -> str:
        return (
            f"predicted: {duration(self.total_s)} +- {100 * self.error:.0f} % (bake {duration(self.bake_s)}, pictures "
            f"{duration(self.render_s)}, ground truth {duration(self.ground_truth_s)}), "
            f"{self.memory_mb / 1000:.1f} GB of memory, {self.disk_mb / 1000:.2f} GB of disk; "
            f"measured on {self.measured_on}"
        )


def cells(spec: SceneSpec) -> int:
    """Return the cells of the flame's whole grid. Raises SpecError: files of a fire of grids are wrong."""
    cell = max(spec.box.size) / spec.box.resolution
    return int(np.prod([max(round(side / cell), 1) for side in spec.box.size]))


def predict(spec: SceneSpec, machine: Machine) -> Prediction:
    """Cost of a dataset made from nothing."""
    count = cells(spec)
    cameras, frames = len(spec.cameras.names), spec.clip.frames
    plates = cameras * _picture_s(spec, machine, 1.0, spec.render.plate_samples)
    grids = 1 + len(spec.ground_truth)
    return Prediction(
        bake_s=machine.start + spec.fire.bake_steps(spec.timeline) * _step_s(spec, machine),
        render_s=machine.start + plates + len(spec.pictures) * _frame_s(spec, machine),
        ground_truth_s=machine.start + frames * count * machine.velocity * grids,
        memory_mb=_memory_mb(spec),
        disk_mb=_disk_mb(spec),
        error=machine.error,
        measured_on=machine.measured_on,
    )


def predict_here(spec: SceneSpec, now: time_left.MachineLoad = time_left.REFERENCE) -> Prediction:
    """Return seconds of the clock on this machine, by what is known of it and what its runs have taken.

    Args:
        now: how slow and crowded it is (`gof.core.time_left`); left out, other programs do not count.
    """
    known, paces = known_machine(), Paces.known()
    prediction = predict(spec, known or REFERENCE)
    now = time_left.MachineLoad(1.0, now.crowded) if known else now
    seconds = paces.expected_s(prediction.by_stage, now)
    if "render" in paces.ratios:
        prediction = replace(prediction, error=LEARNED_ERROR, measured_on="this machine's own runs")
    bake_s, render_s, ground_truth_s = seconds.values()
    return replace(prediction, bake_s=bake_s, render_s=render_s, ground_truth_s=ground_truth_s)


def learn(spec: SceneSpec, cpu_s: Mapping[str, float]) -> None:
    """Keep what the stages of a dataset took, CPU seconds, over what was expected of them."""
    paces, expected = Paces.known(), predict(spec, known_machine() or REFERENCE).by_stage
    for stage in (stage for stage in expected.keys() & cpu_s.keys() if expected[stage] >= LEAST_S):
        paces = paces.with_run(stage, cpu_s[stage] / CORES / expected[stage])
    paces.keep()


def known_machine() -> Machine | None:
    """Coefficients measured on this machine before; None where there are none that this version can read."""
    try:
        return read_record(Machine, machine_file())
    except GofError:
        return None


def remember(machine: Machine) -> None:
    """Keep coefficients for this user; what was learned on top of others is forgotten."""
    write_record(machine_file(), machine)
    Paces.known().without("bake", "render", "ground-truth").keep()


def machine_file() -> Path:
    return time_left.folder() / "machine.json"


def require_room(spec: SceneSpec, root: Path) -> Prediction:
    """Return the prediction for a dataset in the folder `root`, which need not exist yet.

    Raises:
        SpecError: memory or disk of this machine do not suffice, or it would take years; says which field helps.
    """
    require_memory(spec)
    machine = known_machine() or REFERENCE
    prediction = predict_here(spec)
    disk = shutil.disk_usage(next(path for path in (root, *root.parents) if path.exists())).free / 2**20
    if prediction.disk_mb > disk:
        advice = _advice(spec, lambda other: predict(other, machine).disk_mb, 0.9 * disk)
        raise SpecError(
            f"{spec.name}: needs about {prediction.disk_mb / 1000:.3g} GB of disk, {root} has {disk / 1000:.3g} GB "
            f"free; choose another output folder, or {advice}"
        )
    if prediction.total_s > LONGEST_S:
        advice = _advice(spec, lambda other: predict(other, machine).total_s, LONGEST_S)
        years = prediction.total_s / YEAR_S
        raise SpecError(f"{spec.name}: would take this machine about {years:.2g} years; {advice}")
    return prediction


def require_memory(spec: SceneSpec) -> None:
    """Raise SpecError that says which field helps, where this machine has too little memory."""
    need, memory = _memory_mb(spec), memory_mb()
    if need > ROOM * memory:
        raise SpecError(
            f"{spec.name}: needs about {need / 1000:.3g} GB of memory, this machine has {memory / 1000:.3g} GB, of "
            f"which {100 * ROOM:.0f} % may be used; {_advice(spec, _memory_mb, 0.8 * memory)}"
        )


def _advice(spec: SceneSpec, cost: Callable[[SceneSpec], float], room: float) -> str:
    """Return the one field that brings a cost down to what there is room for, and its largest value that does."""
    for name, values, changed in _smaller(spec):
        if cost(changed(values[-1])) <= room:  # the smallest helps: find the largest that does
            first = bisect_left(values, True, key=lambda value, changed=changed: cost(changed(value)) <= room)
            return f"lower {name} from {values[0] + 1} to {values[first]}"
    if spec.domain is None:
        return "lower render.percentage and clip.frames, or resample fire.grids to fewer cells"
    return "lower domain.resolution, render.percentage and clip.frames together"


def _smaller(spec: SceneSpec) -> Iterator[tuple[str, range, Callable[[int], SceneSpec]]]:
    """Yield fields that cost, their smaller values from the largest on, and the spec with one of these."""
    least = -(-400 // min(spec.cameras.sensor_px))
    if spec.domain and spec.domain.resolution > 8:
        yield "domain.resolution", range(spec.domain.resolution - 1, 7, -1), lambda value: with_resolution(spec, value)
    if spec.render.percentage > least:
        yield (
            "render.percentage",
            range(spec.render.percentage - 1, least - 1, -1),
            lambda value: replace(spec, render=replace(spec.render, percentage=value)),
        )
    if spec.clip.frames > 1:
        yield (
            "clip.frames",
            range(spec.clip.frames - 1, 0, -1),
            lambda value: replace(spec, clip=replace(spec.clip, frames=value)),
        )


def memory_mb() -> float:
    """Memory of this machine, used or not."""
    if sys.platform == "win32":
        import ctypes

        status = (ctypes.c_uint64 * 8)(64)  # MEMORYSTATUSEX: its own size, then load; total physical memory is next
        ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
        return status[1] / 2**20
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**20


def stage_settings(stage: str, spec: SceneSpec) -> dict:
    """Return the settings that explain a stage's cost, for costs.json."""
    frames, cameras, resolution = spec.clip.frames, len(spec.cameras.names), spec.box.resolution
    return {
        "bake": {"resolution": resolution, "steps": spec.fire.bake_steps(spec.timeline), "effects": spec.effect_names},
        "render": {
            "images": len(spec.pictures),
            "percentage": spec.render.percentage,
            "samples": spec.render.samples,
            "effects": spec.effect_names,
        },
        "ground-truth": {"frames": frames, "resolution": resolution},
        "video": {"cameras": cameras},
        "flow": {"images": len(spec.pictures)},
        "finish": {},
    }[stage]


def picture_s(machine: Machine, pixels: float, samples: int, resolution: int) -> float:
    return machine.picture + pixels * (
        machine.pixel + samples * (machine.sample + machine.sample_per_cell * resolution)
    )


def with_resolution(spec: SceneSpec, resolution: int) -> SceneSpec:
    return replace(spec, domain=replace(spec.domain, resolution=resolution))


def _step_s(spec: SceneSpec, machine: Machine) -> float:
    """Return seconds of one step of the bake: of the solver, or of reading grids and writing them for Cycles."""
    count = cells(spec)
    if spec.domain is None:
        return machine.velocity * count
    return machine.bake_scale * count**machine.bake_power * (1 + NOISE_BAKE * _fine_cells(spec))


def _fine_cells(spec: SceneSpec) -> int:
    """Return cells of detail per cell of the flow, 0 without fine noise."""
    noise = next((e for e, name in zip(spec.effects, spec.effect_names, strict=True) if name == "fine_noise"), None)
    return noise.scale**3 if noise else 0


def _memory_mb(spec: SceneSpec) -> float:
    """Return the memory of the bake and a renderer, which run at the same time."""
    count, fine, pixels = cells(spec), _fine_cells(spec), math.prod(spec.picture_px)
    bake_mb = BAKE_MB + count * BAKE_BYTES_PER_CELL * (1 + NOISE_MEMORY * fine) / 2**20
    scene = count * RENDER_BYTES_PER_CELL * (1 + fine / 4)
    return bake_mb + RENDER_MB + (scene + pixels * RENDER_BYTES_PER_PIXEL) / 2**20


def _disk_mb(spec: SceneSpec) -> float:
    """Return the disk space of pictures, the solver's cache and the ground truth, while a dataset is made."""
    frames, grids = spec.clip.frames, 1 + len(spec.ground_truth)
    images = math.prod(spec.picture_px) * len(spec.pictures) * PICTURE_BYTES_PER_PIXEL
    steps = len(spec.timeline.steps_needed) + spec.fire.bake_steps(spec.timeline) * _fine_cells(spec) / 4
    cache = steps * CACHE_BYTES_PER_CELL_STEP + STATE_BYTES_PER_CELL
    return (images + cells(spec) * (cache + frames * grids * VELOCITY_BYTES_PER_CELL_FRAME)) / 2**20


def _frame_s(spec: SceneSpec, machine: Machine) -> float:
    """Return seconds of one picture, with all the solver steps that its shutter sees."""
    _, weights = spec.timeline.weights(0, 0)
    samples = max(1, round(spec.render.samples * float(weights.max())))
    samples *= SMOKE_SAMPLE if "smoke" in spec.effect_names else 1
    margin = 0 if len(weights) == 1 else 16
    parts = [min((np.count_nonzero(weight) + margin) / len(weight), 1.0) for weight in weights]
    soot = SOOT_PICTURE if spec.fire.dims else 1.0
    return soot * sum(_picture_s(spec, machine, part, samples) for part in parts)


def _picture_s(spec: SceneSpec, machine: Machine, part: float, samples: int) -> float:
    return picture_s(machine, part * math.prod(spec.picture_px), samples, spec.box.resolution)
