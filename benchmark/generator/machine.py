"""The generator's cost model on this machine: its coefficients measured, and specs refused that do not fit.

`calibrate` fits the coefficients to a few tiny runs (about a minute) and then predicts and makes one more, which they
were not fitted to: that difference is the prediction error shown with every estimate. Large grids are an extrapolation
by the power p.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from gof.core import time_left
from gof.core.errors import DataFormatError, GofError
from gof.core.records import read_record, write_record
from gof.host.terminal import progress_bar
from gof_benchmark.generator.blender_process import Renderer, run_stage
from gof_benchmark.scenes import claim, load_scene
from gof_blender.core.checked_json import SpecError
from gof_blender.pure.cost_model import (
    CORES,
    Machine,
    Prediction,
    cells,
    known_machine,
    machine_file,
    picture_s,
    predict_here,
    remember,
    require_room,
    with_resolution,
)
from gof_blender.pure.cost_model import REFERENCE as REFERENCE
from gof_blender.pure.cost_model import predict as predict
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

LEAST_POWER = 1.13  # from 64 to 128 cells along the longest side 1.13 to 1.16; smaller grids hide it in the caches
MOST_POWER = 1.4
LEAST_BAKE = 0.05  # share of a run that is its steps, where its start hides them
FRAMES = 2  # of a tiny run's clip


def require_machine_for(spec: SceneSpec, root: Path) -> Prediction:
    """Print the prediction.

    Raises:
        GofError: memory or disk of this machine do not suffice; says what would fit.
    """
    print(predict_here(spec, time_left.MachineLoad.measured_now()), flush=True)
    return refuse(spec, root)


def refuse(spec: SceneSpec, root: Path) -> Prediction:
    """Return the prediction. Raises GofError: this machine cannot make the dataset; says which field helps."""
    try:
        return require_room(spec, root)
    except SpecError as error:
        raise GofError(f"{error} (--out, --scheduler: another disk, a larger machine)") from error


def this_machine() -> Machine:
    """Return this machine's coefficients: those measured before, or measured now."""
    return known_machine() or calibrate()


@dataclass(frozen=True)
class TinyRun:
    """A bake of a few steps and single pictures of it, in CPU seconds over cores.

    Attributes:
        resolution: cells along the longest side.   cells: of the whole grid.   steps: of the solver.
        velocity_s: of exporting the ground truth of `FRAMES` frames; None without pictures.
        pictures: (pixels, samples, seconds) each.
    """

    resolution: int
    cells: int
    steps: int
    bake_s: float
    velocity_s: float | None
    pictures: tuple[tuple[int, int, float], ...]


RUNS = {  # of the calibration: cells along the longest side, solver steps, and pictures of (percentage, samples)
    "empty": (8, 2, ()),
    "small": (32, 24, ((25, 4),)),
    "large": (56, 14, ((10, 2), (25, 2), (25, 16))),
    "unseen": (44, 20, ((18, 8),)),
}
STAGES = sum(1 + 2 * len(pictures) for *_, pictures in RUNS.values())  # Blender processes that are waited for


@dataclass(frozen=True)
class Measured:
    """A calibration's measurements so far: it goes on there after it was stopped."""

    SCHEMA: ClassVar[str] = "gof-calibration"
    VERSION: ClassVar[int] = 1

    runs: dict[str, TinyRun] = field(default_factory=dict)

    @classmethod
    def path(cls) -> Path:
        return machine_file().with_name("calibration.json")

    @classmethod
    def read(cls) -> dict[str, TinyRun]:
        """Run by name; none where there is no such file that this version reads."""
        try:
            return {name: run for name, run in read_record(cls, cls.path()).runs.items() if name in RUNS}
        except DataFormatError:
            return {}


def calibrate() -> Machine:
    """Measure this machine with tiny runs and keep the coefficients for later."""
    demo, runs = load_scene("demo", "toy"), Measured.read()
    done = sum(1 + 2 * len(RUNS[name][2]) for name in runs)
    with tempfile.TemporaryDirectory() as folder, progress_bar("measuring this machine (once)") as update:

        def tick() -> None:
            nonlocal done
            done += 1
            update(min(done, STAGES), STAGES)

        update(done, STAGES)
        for name in (name for name in RUNS if name not in runs):
            runs[name] = measure(demo, Path(folder) / name, *RUNS[name], tick)
            write_record(Measured.path(), Measured(dict(runs)))
    fitted = fit(runs["empty"], runs["small"], runs["large"])
    machine = replace(fitted, error=prediction_error(fitted, runs["unseen"]))
    remember(machine)
    Measured.path().unlink(missing_ok=True)
    return machine


def fit(empty: TinyRun, small: TinyRun, large: TinyRun) -> Machine:
    """Return the coefficients that explain three runs; their error is not known yet, and 0 here."""
    # Blender's first start reads its files from the disk and may take longer than a later start and its bake.
    start = min(run.bake_s for run in (empty, small, large))
    small_step, large_step = (max(run.bake_s - start, LEAST_BAKE * run.bake_s) / run.steps for run in (small, large))
    power = np.log(large_step / small_step) / np.log(large.cells / small.cells)
    power = float(np.clip(power, LEAST_POWER, MOST_POWER))
    picture, pixel, sample, sample_per_cell = _fit_pictures((small, large))
    return Machine(
        start=start,
        bake_scale=large_step / large.cells**power,
        bake_power=power,
        picture=picture,
        pixel=pixel,
        sample=sample,
        sample_per_cell=sample_per_cell,
        velocity=max(large.velocity_s - start, 0.01) / (FRAMES * large.cells),
        error=0.0,
        measured_on=f"{platform.node() or 'this machine'} ({os.cpu_count()} cores, {time.strftime('%Y-%m-%d')})",
    )


def _fit_pictures(runs: tuple[TinyRun, ...]) -> list[float]:
    """Return seconds per picture, per pixel, per sample and per sample and cell: non-negative, least relative error."""
    from scipy.optimize import nnls

    pictures = [(run.resolution, *picture) for run in runs for picture in run.pictures]
    terms = np.array([(1.0, p, p * s, p * s * resolution) for resolution, p, s, _ in pictures])
    seconds = np.array([t for *_, t in pictures])
    coefficients, _ = nnls(terms / seconds[:, None], np.ones(len(seconds)))
    return coefficients.tolist()


def prediction_error(machine: Machine, run: TinyRun) -> float:
    """Return the larger relative error of the predicted bake and picture of a run that nothing was fitted to."""
    pixels, samples, seconds = run.pictures[0]
    bake_s = machine.start + run.steps * machine.bake_scale * run.cells**machine.bake_power
    pairs = ((run.bake_s, bake_s), (seconds, picture_s(machine, pixels, samples, run.resolution)))
    return max(abs(predicted - true) / true for true, predicted in pairs)


def measure(
    demo: SceneSpec,
    root: Path,
    resolution: int,
    steps: int,
    pictures: tuple[tuple[int, int], ...] = (),
    tick: Callable[[], None] = lambda: None,
) -> TinyRun:
    """Bake a small scene, and render single pictures, (percentage, samples) each, of its last frame; `tick` is called
    after every Blender process."""
    clip = replace(demo.clip, frames=FRAMES, warm_up_frames=max(steps - FRAMES, 0))
    spec = replace(with_resolution(demo, resolution), clip=clip)
    layout = _bake_folder(spec, root / "0", *(pictures[0] if pictures else (6, 1)))
    bake_s = _stage_s("bake", layout)
    tick()
    velocity_s = _stage_s("ground-truth", layout) if pictures else None
    rendered = []
    for index, (percentage, samples) in enumerate(pictures):
        if index:
            layout = _bake_folder(spec, root / str(index), percentage, samples)
            _stage_s("bake", layout)
        tick()
        width, height = (side * percentage // 100 for side in spec.cameras.sensor_px)
        rendered.append((width * height, samples, _picture_s(layout)))
        tick()
    return TinyRun(resolution, cells(spec), spec.timeline.last_frame, bake_s, velocity_s, tuple(rendered))


def _bake_folder(spec: SceneSpec, root: Path, percentage: int, samples: int) -> Layout:
    render = replace(spec.render, percentage=percentage, samples=samples, denoise=True)
    layout = Layout(root)
    claim(layout, replace(spec, render=render))
    return layout


def _stage_s(stage: str, layout: Layout) -> float:
    return run_stage(stage, layout.root).cpu_s / CORES


def _picture_s(layout: Layout) -> float:
    """Return median of three pictures, after one that loads the scene."""
    times = []
    for _ in range(4):
        times.append(Renderer.render(layout.root, 1, 1).cpu_s / CORES)
        for path in vars(layout.frame("cam_1", 1)).values():
            path.unlink()
    Renderer.close(layout.root)
    return float(np.median(times[1:]))
