"""Measure this machine for the cost model of `gof_blender.pure.cost_model`, and refuse what does not fit it.

`calibrate` fits the coefficients to a few tiny runs (about a minute) and then predicts and makes one more, which they
were not fitted to: that difference is the prediction error shown with every estimate. Large grids are an extrapolation
by the power p.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from gof.errors import GofError
from gof.io.files import write_json
from gof_blender.pure.checked_json import SpecError
from gof_blender.pure.cost_model import (
    CORES,
    REFERENCE,
    Machine,
    Prediction,
    cells,
    known_machine,
    machine_file,
    picture_s,
    predict,
    require_room,
    with_resolution,
)
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

__all__ = [
    "REFERENCE",
    "Machine",
    "Prediction",
    "calibrate",
    "cells",
    "known_machine",
    "machine",
    "predict",
    "refuse_if_too_large",
]

LEAST_POWER = 1.13  # from 64 to 128 cells along the longest side 1.13 to 1.16; smaller grids hide it in the caches


def refuse_if_too_large(spec: SceneSpec, root: Path) -> Prediction:
    """Print the prediction.

    Raises:
        GofError: memory or disk of this machine do not suffice; says what would fit.
    """
    print(predict(spec, known_machine() or REFERENCE), flush=True)
    try:
        return require_room(spec, root)
    except SpecError as error:
        raise GofError(f"{error} (--out, --scheduler: another disk, a larger machine)") from error


def machine() -> Machine:
    """This machine's coefficients: those measured before, or measured now."""
    return known_machine() or calibrate()


def calibrate() -> Machine:
    """Measure this machine with tiny runs and keep the coefficients for later."""
    from gof_benchmark.commands.generate import load_scene

    print("measuring this machine (about a minute) ...", flush=True)
    demo = load_scene("demo", "toy")
    with tempfile.TemporaryDirectory() as folder:
        measured = [
            _measure(demo, Path(folder) / str(index), *setting)
            for index, setting in enumerate(
                (
                    # resolution, steps, [(percentage, samples), ...]
                    (8, 2, []),
                    (32, 24, [(25, 4)]),
                    (56, 14, [(10, 2), (25, 2), (25, 16)]),
                )
            )
        ]
        empty, small, large = measured
        start = empty["bake_s"]
        per_step = [(m["bake_s"] - start) / m["steps"] for m in (small, large)]
        power = float(
            np.clip(np.log(per_step[1] / per_step[0]) / np.log(large["cells"] / small["cells"]), LEAST_POWER, 1.4)
        )
        rows = [(1.0, p, p * s, p * s * m["resolution"]) for m in (small, large) for p, s, _ in m["pictures"]]
        times = [t for m in (small, large) for _, _, t in m["pictures"]]
        from scipy.optimize import nnls

        coefficients, _ = nnls(np.array(rows) / np.array(times)[:, None], np.ones(len(times)))
        velocity = max(large["velocity_s"] - start, 0.01) / (large["frames"] * large["cells"])
        where = f"{platform.node() or 'this machine'} ({os.cpu_count()} cores, {time.strftime('%Y-%m-%d')})"
        result = Machine(
            start, per_step[1] / large["cells"] ** power, power, *map(float, coefficients), velocity, 0.0, where
        )
        # One more, which nothing was fitted to.
        test = _measure(demo, Path(folder) / "test", 44, 20, [(18, 8)])
        pixels, samples, seconds = test["pictures"][0]
        spec = with_resolution(demo, 44)
        pairs = [
            (test["bake_s"], start + test["steps"] * result.bake_scale * test["cells"] ** power),
            (seconds, picture_s(result, pixels, samples, spec.domain.resolution)),
        ]
        result = replace(result, error=max(abs(b - a) / a for a, b in pairs))
    write_json(machine_file(), asdict(result))
    return result


def _measure(demo: SceneSpec, root: Path, resolution: int, steps: int, pictures: list[tuple[int, int]]) -> dict:
    """Bake a small scene and render single pictures of its last frame; median of three each."""
    from gof_benchmark.commands.generate import claim
    from gof_benchmark.generator.blender_process import Renderer, run_stage

    spec = replace(
        with_resolution(demo, resolution), clip=replace(demo.clip, frames=2, warm_up_frames=max(steps - 2, 0))
    )
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
