"""A trained 4DGS (Wu) as a `gof-trajectory/1`, sampled and differentiated with the method's own classes.

Run inside a launched process: the checkout's folder is on `sys.path`, its compiled modules have stand-ins.
"""

from __future__ import annotations

import ast
import re
from argparse import Namespace
from importlib import import_module
from pathlib import Path

import numpy as np
import torch

from gof.core.errors import DataFormatError
from gof.core.trajectory import Trajectory
from gof.dataset import Dataset

STEP_S = 1e-4  # of the differences, in float64: a ten thousandth of a second is a hundredth of a frame or less
CLOCKS = {  # by the layout that it was trained on: the method's time at frame k of K, as its reader counts
    "hypernerf": lambda count: np.arange(count) / max(count - 1, 1),
    "multipleview": lambda count: np.arange(count) / count,
}


def export(model: Path, dataset: Path, out: Path) -> str:
    """Write the Gaussians at the frame times and half steps of a dataset, with velocities.

    Args:
        model: a training's output folder, with `cfg_args` and `point_cloud/iteration_*`; the last one is taken.
    Returns:
        What was written, in words.
    Raises:
        DataFormatError: no finished training there, or one on another layout than these two.
    """
    settings = read_settings(model / "cfg_args")
    folder, iteration = _last_iteration(model)
    gaussians = import_module("scene.gaussian_model").GaussianModel(settings.sh_degree, settings)
    gaussians.load_ply(str(folder / "point_cloud.ply"))
    gaussians.load_model(str(folder))
    frames = Dataset.open(dataset).times_s
    half_steps = np.arange(2 * len(frames) - 1) / 2
    times = np.interp(half_steps, np.arange(len(frames)), frames)
    state = _State(gaussians, frames, clock_of(Path(settings.source_path), len(frames)))
    samples = [state.at(time) for time in times]
    velocity = [state.velocity(time) for time in times]
    names = ("position", "scale", "rotation", "opacity", "color")
    stacked = {name: np.stack([sample[k] for sample in samples]) for k, name in enumerate(names)}
    color = stacked.pop("color")
    swing = float(np.abs(color - color.mean(0)).max())
    Trajectory(time_s=times, velocity=np.stack(velocity), color=color.mean(0), **stacked).save(out)
    said = f"{len(color[0])} Gaussians of iteration {iteration} at {len(times)} times written to {out}"
    if swing > 0:
        said += f"; their colours change with time (coefficients by up to {swing:.2g}) and are kept at their mean"
    return said


class _State:
    """The method's Gaussians as a function of seconds, in float64."""

    def __init__(self, gaussians, frames: np.ndarray, clock: np.ndarray):
        self._gaussians, self._frames, self._clock = gaussians, frames, clock
        self._network = gaussians._deformation.double().eval()
        self._inputs = [
            tensor.detach().double()
            for tensor in (
                gaussians.get_xyz,
                gaussians._scaling,
                gaussians._rotation,
                gaussians._opacity,
                gaussians.get_features,
            )
        ]

    def _deformed(self, time_s: float):
        clock = np.interp(time_s, self._frames, self._clock)
        times = torch.full((len(self._inputs[0]), 1), float(clock), dtype=torch.float64)
        with torch.no_grad():
            return self._network(*self._inputs, times)

    def at(self, time_s: float) -> tuple[np.ndarray, ...]:
        """position, scale, rotation, opacity, harmonics."""
        position, scale, rotation, opacity, harmonics = self._deformed(time_s)
        model = self._gaussians
        activated = (
            position,
            model.scaling_activation(scale),
            model.rotation_activation(rotation),
            model.opacity_activation(opacity)[:, 0],
            harmonics,
        )
        return tuple(tensor.numpy() for tensor in activated)

    def velocity(self, time_s: float) -> np.ndarray:
        """Return (N, 3) m/s: central differences, one-sided at the clip's two ends."""
        before, after = np.clip([time_s - STEP_S, time_s + STEP_S], self._frames[0], self._frames[-1])
        return ((self._deformed(after)[0] - self._deformed(before)[0]) / (after - before)).numpy()


def clock_of(trained_on: Path, count: int) -> np.ndarray:
    """Return (K,) the method's time at every frame. Raises DataFormatError: the folder is not named as a layout of
    ours."""
    if trained_on.name not in CLOCKS:
        raise DataFormatError(
            f"{trained_on}: the training's folder is neither a 'hypernerf' nor a 'multipleview' view, "
            "so how its reader counted time is not known"
        )
    return CLOCKS[trained_on.name](count)


def read_settings(path: Path) -> Namespace:
    """Return a training's `cfg_args`, "Namespace(name=value, ...)": plain values, read and never executed.

    Raises:
        DataFormatError: no such file, or it holds something else.
    """
    try:
        call = ast.parse(path.read_text(encoding="utf-8"), mode="eval").body
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Namespace"):
            raise ValueError("it is no Namespace")
        values = {word.arg: ast.literal_eval(word.value) for word in call.keywords if word.arg is not None}
        if len(values) < len(call.keywords):
            raise ValueError("a value has no name")
        return Namespace(**values)
    except (OSError, ValueError, SyntaxError, TypeError, RecursionError) as e:
        raise DataFormatError(f"{path}: not the settings of a training of 4DGS (Wu): {e}") from e


def _last_iteration(model: Path) -> tuple[Path, int]:
    found = {int(p.name[10:]): p for p in model.glob("point_cloud/iteration_*") if re.fullmatch(r"\d+", p.name[10:])}
    if not found:
        raise DataFormatError(f"{model}: has no point_cloud/iteration_*; did the training reach a step that it saves?")
    return found[max(found)], max(found)
