"""Trained deformation networks as `gof-trajectory/1`, sampled and differentiated with the method's own classes.

Run inside a launched process: the checkout's folder is on `sys.path`, its compiled modules have stand-ins. 4DGS (Wu),
Grid4D and Deformable-3DGS differ in how a network moves its Gaussians; when they are sampled is the same for all.
"""

from __future__ import annotations

import ast
import re
from argparse import Namespace
from collections.abc import Callable
from importlib import import_module
from itertools import permutations
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gof.core.errors import DataFormatError
from gof.core.trajectory import Trajectory
from gof.dataset import Dataset
from gof.on_cpu.gaussian_rasterizer import covariance

STEP_S = 1e-4  # of the differences, in float64: a ten thousandth of a second is a hundredth of a frame or less
CLOCKS = {  # by the layout that it was trained on: the method's time at frame k of K, as its reader counts
    "hypernerf": lambda count: np.arange(count) / max(count - 1, 1),
    "nerfds": lambda count: np.arange(count) / max(count - 1, 1),
    "multipleview": lambda count: np.arange(count) / count,
}
LEAST_SCALE = 1e-9  # m; a network may take a scale to 0, a trajectory may not
NAMES = ("position", "scale", "rotation", "opacity", "color")
Deformed = Callable[[float], "tuple[np.ndarray, ...]"]  # the method's time -> arrays in the order of NAMES


def export_wu(model: Path, dataset: Path, out: Path) -> str:
    """Write 4DGS (Wu)'s Gaussians at the frame times and half steps of a dataset, with velocities.

    Args:
        model: a training's output folder, with `cfg_args` and `point_cloud/iteration_*`; the last one is taken.
    Returns:
        A line about the written file.
    Raises:
        DataFormatError: no finished training there, or one on a layout whose clock is not known.
    """
    settings = read_settings(model / "cfg_args")
    folder, iteration = _last_iteration(model)
    gaussians = import_module("scene.gaussian_model").GaussianModel(settings.sh_degree, settings)
    gaussians.load_ply(str(folder / "point_cloud.ply"))
    gaussians.load_model(str(folder))
    network = gaussians._deformation.double().eval()
    inputs = [
        tensor.detach().double()
        for tensor in (
            gaussians.get_xyz,
            gaussians._scaling,
            gaussians._rotation,
            gaussians._opacity,
            gaussians.get_features,
        )
    ]

    def deformed(clock: float):
        times = torch.full((len(inputs[0]), 1), clock, dtype=torch.float64)
        position, scale, rotation, opacity, harmonics = network(*inputs, times)
        activated = (
            position,
            gaussians.scaling_activation(scale),
            gaussians.rotation_activation(rotation),
            gaussians.opacity_activation(opacity)[:, 0],
            harmonics,
        )
        return tuple(tensor.numpy() for tensor in activated)

    return _write(deformed, settings, iteration, dataset, out)


def export_grid4d(model: Path, dataset: Path, out: Path) -> str:
    """As `export_wu`, of Grid4D: its network turns a Gaussian's place about the world's origin and shifts it."""
    settings, gaussians, iteration = _trained(model)
    network = import_module("scene.deform_model").DeformModel(
        settings.grid_args,
        settings.network_args,
        scale_xyz=settings.scale_xyz,
        reg_spatial_able=False,
        reg_temporal_able=False,
    )
    network.load_weights(str(model), iteration)
    network.deform.double().eval()
    for encoder in network.grid4d.double().eval().children():
        for name in ("per_level_scale", "base_resolution"):  # a level's size is rounded in float32, as when trained
            setattr(encoder, name, getattr(encoder, name).float())
    turned = import_module("utils.general_utils").quaternion_to_matrix

    def move(xyz, times):
        step = network.step(xyz, times)
        moved = (turned(step["d_xyz"][:, :4]) @ xyz[:, :, None])[:, :, 0] + step["d_xyz"][:, 4:]
        return moved, step["d_rotation"], step["d_scaling"]

    return _write(_moved(gaussians, move), settings, iteration, dataset, out)


def export_deformable(model: Path, dataset: Path, out: Path) -> str:
    """As `export_wu`, of Deformable-3DGS: its network shifts, or, with `--is_6dof`, moves as a screw does."""
    settings, gaussians, iteration = _trained(model)
    network = import_module("scene.deform_model").DeformModel(settings.is_blender, settings.is_6dof)
    network.load_weights(str(model), iteration)
    network.deform.double().eval()

    def move(xyz, times):
        shift, rotation, scale = network.step(xyz, times)
        if not settings.is_6dof:
            return xyz + shift, rotation, scale
        along = shift @ torch.cat([xyz, torch.ones_like(xyz[:, :1])], 1)[:, :, None]
        return along[:, :3, 0] / along[:, 3:, 0], rotation, scale

    return _write(_moved(gaussians, move), settings, iteration, dataset, out)


def _trained(model: Path):
    """Return settings, Gaussians and iteration of a training whose network stands beside its Gaussians."""
    settings = read_settings(model / "cfg_args")
    folder, iteration = _last_iteration(model)
    gaussians = import_module("scene.gaussian_model").GaussianModel(settings.sh_degree)
    gaussians.load_ply(str(folder / "point_cloud.ply"))
    return settings, gaussians, iteration


def _moved(gaussians, move: Callable) -> Deformed:
    """Return the Gaussians as a function of the method's time; scales and quaternions have offsets added."""
    xyz, scale, rotation, opacity, harmonics = (
        tensor.detach().double()
        for tensor in (
            gaussians.get_xyz,
            gaussians.get_scaling,
            gaussians.get_rotation,
            gaussians.get_opacity,
            gaussians.get_features,
        )
    )

    def deformed(clock: float):
        times = torch.full((len(xyz), 1), clock, dtype=torch.float64)
        position, turn, growth = move(xyz, times)
        axes = as_drawn(scale + growth, rotation + turn)
        return position.numpy(), *axes, opacity[:, 0].numpy(), harmonics.numpy()

    return deformed


def as_drawn(scales, quaternions) -> tuple[np.ndarray, np.ndarray]:
    """Return scales (N, 3), positive, and unit quaternions (N, 4) of the ellipsoids that are drawn from any of both.

    Rasterisers take a quaternion as it is, and one that is not of unit length is no rotation: its ellipsoid has other
    axes. Axes are given in the order, and with the signs, that lie nearest to those of the normalised quaternion.
    """
    wanted = Rotation.from_quat(np.asarray(quaternions)[:, [1, 2, 3, 0]]).as_matrix()
    variance, axes = np.linalg.eigh(covariance(scales, quaternions).numpy())
    near = np.einsum("nji,njk->nik", wanted, axes)  # cosines between a wanted and a found axis
    orders = np.array(list(permutations(range(3))))
    fit = sum(np.abs(near[:, axis, orders[:, axis]]) for axis in range(3))
    order = orders[fit.argmax(1)]
    axes = np.take_along_axis(axes, order[:, None, :], 2)
    axes = axes * np.where(np.einsum("nji,nji->ni", wanted, axes) < 0, -1.0, 1.0)[:, None, :]
    axes[np.linalg.det(axes) < 0, :, 2] *= -1
    variance = np.take_along_axis(variance, order, 1)
    quaternion = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    return np.sqrt(np.maximum(variance, LEAST_SCALE**2)), quaternion


def _write(deformed: Deformed, settings: Namespace, iteration: int, dataset: Path, out: Path) -> str:
    """Sample at frame times and half steps, with central differences (one-sided at the clip's ends) as velocities."""
    frames = Dataset.open(dataset).times_s
    clock = clock_of(Path(settings.source_path), len(frames))
    half_steps = np.arange(2 * len(frames) - 1) / 2
    times = np.interp(half_steps, np.arange(len(frames)), frames)

    def at(time_s: float):
        with torch.no_grad():
            return deformed(float(np.interp(time_s, frames, clock)))

    samples, velocity = [], []
    for time in times:
        before, after = np.clip([time - STEP_S, time + STEP_S], frames[0], frames[-1])
        samples.append(at(time))
        velocity.append((at(after)[0] - at(before)[0]) / (after - before))
    stacked = {name: np.stack([sample[k] for sample in samples]) for k, name in enumerate(NAMES)}
    color = stacked.pop("color")
    swing = float(np.abs(color - color.mean(0)).max())
    Trajectory(time_s=times, velocity=np.stack(velocity), color=color.mean(0), **stacked).save(out)
    message = f"{len(color[0])} Gaussians of iteration {iteration} at {len(times)} times written to {out}"
    if swing > 0:
        message += f"; their colours change with time (coefficients by up to {swing:.2g}) and are kept at their mean"
    return message


def clock_of(trained_on: Path, count: int) -> np.ndarray:
    """Return (K,) the method's time at every frame. Raises DataFormatError: the folder is not named as a layout of
    ours."""
    if trained_on.name not in CLOCKS:
        raise DataFormatError(
            f"{trained_on}: the training's folder is none of the views {', '.join(CLOCKS)}, "
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
        raise DataFormatError(f"{path}: not the settings of a training: {e}") from e


def _last_iteration(model: Path) -> tuple[Path, int]:
    found = {int(p.name[10:]): p for p in model.glob("point_cloud/iteration_*") if re.fullmatch(r"\d+", p.name[10:])}
    if not found:
        raise DataFormatError(f"{model}: has no point_cloud/iteration_*; did the training reach a step that it saves?")
    return found[max(found)], max(found)
