"""What a dataset will cost on this machine, before it is made: a small linear model with measured coefficients.

    bake     start + steps * a * cells^p
    picture  b + pixels * (c + samples * (d + e * resolution))        the flame is marched in steps of a cell
    velocity start + frames * f * cells

`calibrate` measures the coefficients with a few tiny runs (about a minute) and then predicts and makes one more, which
it was not fitted to: that difference is the prediction error shown with every estimate. Large grids are an
extrapolation by the power p.
"""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from blender_addon import shutter
from blender_addon.layout import Layout
from blender_addon.spec import SceneSpec
from gof.errors import GofError
from gof.io.files import read_json, write_json

# Measured on Blender 4.5, see docs/costs.md.
BAKE_MB, BAKE_BYTES_PER_CELL = 260.0, 270.0
RENDER_MB, RENDER_BYTES_PER_CELL, RENDER_BYTES_PER_PIXEL = 330.0, 60.0, 700.0
CACHE_BYTES_PER_CELL_STEP, VELOCITY_BYTES_PER_CELL_FRAME = 14.0, 6.0
PICTURE_BYTES_PER_PIXEL = 10.0
NOISE_BAKE, NOISE_MEMORY = 0.22, 0.3  # of the coarse bake, per fine cell that a coarse cell is divided into
LEAST_POWER = 1.13  # from 64 to 128 cells along the longest side 1.13 to 1.16; smaller grids hide it in the caches
CORES = os.cpu_count() or 1
SMOKE_SAMPLE = 20  # times a sample without smoke: all lamps, through the soot; 6 where it has just begun, 24 in a full domain


@dataclass(frozen=True)
class Machine:
    """Coefficients of the model, processor seconds over cores; `error` is the relative prediction error measured with them."""

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
    """Processor seconds per stage divided by the cores; their sum is the wall time where all cores are busy, as they
    are but for the start and the end: pictures are rendered during the bake. A machine with other work takes longer."""

    bake_s: float
    render_s: float
    ground_truth_s: float
    memory_mb: float
    disk_mb: float
    error: float
    measured_on: str

    @property
    def total_s(self) -> float:
        return self.bake_s + self.render_s + self.ground_truth_s

    def __str__(self) -> str:
        minutes = _duration
        return (
            f"predicted: {minutes(self.total_s)} +- {100 * self.error:.0f} % (bake {minutes(self.bake_s)}, pictures "
            f"{minutes(self.render_s)}, ground truth {minutes(self.ground_truth_s)}), {self.memory_mb / 1000:.1f} GB of "
            f"memory, {self.disk_mb / 1000:.2f} GB of disk; measured on {self.measured_on}"
        )


def cells(spec: SceneSpec) -> int:
    cell = max(spec.domain.size) / spec.domain.resolution
    return int(np.prod([max(round(side / cell), 1) for side in spec.domain.size]))


def predict(spec: SceneSpec, machine: Machine) -> Prediction:
    """Cost of a dataset made from nothing."""
    count, cameras, frames = cells(spec), len(spec.cameras.names), spec.clip.frames
    noise = next((e for e, name in zip(spec.effects, spec.effect_names, strict=True) if name == "fine_noise"), None)
    fine = noise.scale**3 if noise else 0
    step = machine.bake_scale * count**machine.bake_power * (1 + NOISE_BAKE * fine)
    plates = cameras * _picture_s(spec, machine, 1.0, spec.render.plate_samples)
    width, height = (side * spec.render.percentage // 100 for side in spec.cameras.sensor_px)
    grids = 1 + len(spec.ground_truth)
    images = width * height * cameras * frames * PICTURE_BYTES_PER_PIXEL
    stored = count * ((1 + fine / 4) * spec.last_frame * CACHE_BYTES_PER_CELL_STEP + frames * grids * VELOCITY_BYTES_PER_CELL_FRAME)
    bake_mb = BAKE_MB + count * BAKE_BYTES_PER_CELL * (1 + NOISE_MEMORY * fine) / 2**20
    render_mb = RENDER_MB + (count * RENDER_BYTES_PER_CELL * (1 + fine / 4) + width * height * RENDER_BYTES_PER_PIXEL) / 2**20
    return Prediction(
        bake_s=machine.start + spec.last_frame * step,
        render_s=machine.start + plates + cameras * frames * _frame_s(spec, machine),
        ground_truth_s=machine.start + frames * count * machine.velocity * grids,
        memory_mb=bake_mb + render_mb,  # both run at the same time
        disk_mb=(images + stored) / 2**20,
        error=machine.error,
        measured_on=machine.measured_on,
    )


def refuse_if_too_large(spec: SceneSpec, root: Path) -> Prediction:
    """Print the prediction.

    Raises:
        GofError: memory or disk of this machine do not suffice; says what would fit.
    """
    import psutil

    prediction = predict(spec, known_machine() or REFERENCE)
    print(prediction, flush=True)
    memory, disk = psutil.virtual_memory().total / 2**20, shutil.disk_usage(root).free / 2**20
    if prediction.memory_mb > 0.9 * memory:
        smaller = spec.domain.resolution
        while smaller > 8 and predict(_with_resolution(spec, smaller), REFERENCE).memory_mb > 0.8 * memory:
            smaller -= 8
        raise GofError(
            f"{spec.name}: needs about {prediction.memory_mb / 1000:.0f} GB of memory, this machine has "
            f"{memory / 1000:.0f} GB; lower domain.resolution from {spec.domain.resolution} to {smaller}, make "
            "domain.size tighter around the flame, or give --scheduler of a larger machine"
        )
    if prediction.disk_mb > disk:
        raise GofError(
            f"{spec.name}: needs about {prediction.disk_mb / 1000:.1f} GB of disk, {root} has {disk / 1000:.1f} GB free; "
            "give another --out, or lower domain.resolution or clip.frames"
        )
    return prediction


def machine() -> Machine:
    """This machine's coefficients: those measured before, or measured now."""
    return known_machine() or calibrate()


def known_machine() -> Machine | None:
    """Coefficients measured on this machine before, if any."""
    return Machine(**read_json(_file())) if _file().is_file() else None


def calibrate() -> Machine:
    """Measure this machine with tiny runs and keep the coefficients for later."""
    from benchmark.generate import load_scene

    print("measuring this machine (about a minute) ...", flush=True)
    demo = load_scene("demo", "toy")
    with tempfile.TemporaryDirectory() as folder:
        measured = [_measure(demo, Path(folder) / str(index), *setting) for index, setting in enumerate((
            # resolution, steps, [(percentage, samples), ...]
            (8, 2, []), (32, 24, [(25, 4)]), (56, 14, [(10, 2), (25, 2), (25, 16)])))]  # fmt: skip
        empty, small, large = measured
        start = empty["bake_s"]
        per_step = [(m["bake_s"] - start) / m["steps"] for m in (small, large)]
        power = float(np.clip(np.log(per_step[1] / per_step[0]) / np.log(large["cells"] / small["cells"]), LEAST_POWER, 1.4))
        rows = [(1.0, p, p * s, p * s * m["resolution"]) for m in (small, large) for p, s, _ in m["pictures"]]
        times = [t for m in (small, large) for _, _, t in m["pictures"]]
        from scipy.optimize import nnls

        coefficients, _ = nnls(np.array(rows) / np.array(times)[:, None], np.ones(len(times)))
        velocity = max(large["velocity_s"] - start, 0.01) / (large["frames"] * large["cells"])
        where = f"{platform.node() or 'this machine'} ({os.cpu_count()} cores, {time.strftime('%Y-%m-%d')})"
        result = Machine(start, per_step[1] / large["cells"] ** power, power, *map(float, coefficients), velocity, 0.0, where)
        # One more, which nothing was fitted to.
        test = _measure(demo, Path(folder) / "test", 44, 20, [(18, 8)])
        pixels, samples, seconds = test["pictures"][0]
        spec = _with_resolution(demo, 44)
        pairs = [
            (test["bake_s"], start + test["steps"] * result.bake_scale * test["cells"] ** power),
            (seconds, _seconds(result, pixels, samples, spec.domain.resolution)),
        ]
        result = replace(result, error=max(abs(b - a) / a for a, b in pairs))
    write_json(_file(), asdict(result))
    return result


def _measure(demo: SceneSpec, root: Path, resolution: int, steps: int, pictures: list[tuple[int, int]]) -> dict:
    """Bake a small scene and render single pictures of its last frame; median of three each."""
    from benchmark.blender_process import Renderer, run_stage
    from benchmark.generate import claim

    spec = replace(_with_resolution(demo, resolution), clip=replace(demo.clip, frames=2, warm_up_frames=max(steps - 2, 0)))
    result = {"resolution": resolution, "cells": cells(spec), "steps": spec.last_frame, "frames": 2, "pictures": []}
    for index, (percentage, samples) in enumerate(pictures or [(6, 1)]):
        this = replace(spec, render=replace(spec.render, percentage=percentage, samples=samples, denoise=True))
        layout = Layout(root / str(index))
        claim(layout, this)
        seconds = run_stage("bake", layout.root)["cpu_s"] / CORES
        if index == 0:
            result["bake_s"] = seconds
            if pictures:
                result["velocity_s"] = run_stage("ground-truth", layout.root)["cpu_s"] / CORES
        if pictures:
            times = []
            for _ in range(4):
                times.append(Renderer.render(layout.root, 1, 1)["cpu_s"] / CORES)
                for path in vars(layout.frame("cam_1", 1)).values():
                    path.unlink()
            Renderer.close(layout.root)
            width, height = (side * percentage // 100 for side in spec.cameras.sensor_px)
            result["pictures"].append((width * height, samples, float(np.median(times[1:]))))
    return result


def _frame_s(spec: SceneSpec, machine: Machine) -> float:
    """Seconds of one picture, with all the solver steps that its shutter sees."""
    _, weights = shutter.step_weights(spec, 0, 0)
    samples = max(1, round(spec.render.samples * float(weights.max())))
    samples *= SMOKE_SAMPLE if "smoke" in spec.effect_names else 1
    margin = 0 if len(weights) == 1 else 16
    parts = [min((np.count_nonzero(weight) + margin) / len(weight), 1.0) for weight in weights]
    return sum(_picture_s(spec, machine, part, samples) for part in parts)


def _picture_s(spec: SceneSpec, machine: Machine, part: float, samples: int) -> float:
    width, height = (side * spec.render.percentage // 100 for side in spec.cameras.sensor_px)
    return _seconds(machine, part * width * height, samples, spec.domain.resolution)


def _seconds(machine: Machine, pixels: float, samples: int, resolution: int) -> float:
    return machine.picture + pixels * (machine.pixel + samples * (machine.sample + machine.sample_per_cell * resolution))


def _with_resolution(spec: SceneSpec, resolution: int) -> SceneSpec:
    return replace(spec, domain=replace(spec.domain, resolution=resolution))


def _file() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "gof" / "machine.json"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
