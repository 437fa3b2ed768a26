"""A textured column of Gaussians rising at a constant velocity through a few small views.

Truth for position, speed and picture.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.core.fields import VelocityField
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.reconstruct import pipeline
from gof.reconstruct.curve import Curve, HeldOutScores
from gof.reconstruct.settings import ReconstructionSettings
from gof.render import render
from tests.conftest import arc, write_dataset

RISE = np.array([0.1, 0.0, 1.2])  # m/s
DT = 0.02


def column(times, n=500) -> TransientGaussians:
    rng = np.random.default_rng(0)
    position = np.stack([*rng.normal(0, 0.08, (2, n)), rng.uniform(-0.2, 1.8, n)], -1) - RISE * times.mean()
    return TransientGaussians(
        position=position,
        velocity=np.tile(RISE, (n, 1)),
        t_mu=np.full(n, 0.0),
        t_sigma=np.full(n, np.inf),
        scale=rng.uniform(0.015, 0.04, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0.05, 0.5, n) * rng.uniform(0.5, 1, n),
        color=np.tile([1.0, 0.6, 0.15], (n, 1)),  # of light: fire hides no more than it shines
        dynamic=np.ones(n, bool),
    )


def write_flame(
    folder: Path,
    frames=10,
    dt=DT,
    cameras=3,
    focal_px=110.0,
    late=None,
    row_time_s=0.0,
    change=lambda images: images,
    test_frames=(4,),
) -> Path:
    """The dataset.

    Args:
        late: {camera: seconds by which its clock is behind}.
        change: (T, C, H, W, 3) pictures -> pictures.
    """
    times = dt * np.arange(frames)
    views = [replace(camera, row_time_s=row_time_s) for camera in arc(cameras, width=48, height=96, focal_px=focal_px)]
    flame = column(times)
    rng = np.random.default_rng(1)
    plates = np.full((cameras, 96, 48, 3), 0.15) + 0.1 * rng.random((cameras, 96, 48, 1))
    late = late or {}
    images = [
        [render(flame, view, t + late.get(c, 0.0), background=plates[c])["color"] for c, view in enumerate(views)]
        for t in times
    ]
    grid = VelocityField.from_array(np.broadcast_to(RISE, (8, 8, 24, 3)), (-0.6, -0.6, -0.8), 0.15)
    fields = [VelocityField(grid.velocity, grid.index_to_world, t) for t in times]
    write_dataset(folder, views, change(np.array(images)), plates, times, fields, test_frames=list(test_frames))
    if late:
        own = {f"cam_{c}": {"time_s": (times + seconds).tolist()} for c, seconds in late.items()}
        edit(folder, lambda meta: [camera.update(own.get(camera["name"], {})) for camera in meta["cameras"]])
    return folder


def edit(folder: Path, change) -> Path:
    """Change dataset.json in place: change(meta)."""
    meta = json.loads((folder / "dataset.json").read_text())
    change(meta)
    (folder / "dataset.json").write_text(json.dumps(meta))
    return folder


def reconstruct(folder: Path, out: Path, **changes) -> Path:
    """Reconstruct a dataset with little effort and changed settings; the path of the result."""
    small = {"gaussians": 1500, "iterations": 200, "voxels": 32, "longest_side": 320, "flow_prior": False}
    dataset = Dataset.open(folder)
    settings = ReconstructionSettings(dataset=dataset.identity(), **(small | changes))
    return pipeline.reconstruct(dataset, settings, out).path


def held_out(result: Path) -> HeldOutScores:
    """Scores of the last step on held-out pictures."""
    return Curve.read(result.parent).points[-1].scores


def mean_velocity(gaussians: TransientGaussians) -> np.ndarray:
    """Velocity of what is seen: mean weighted by opacity times volume, m/s."""
    weight = gaussians.opacity * gaussians.scale.astype(np.float64).prod(-1)
    return (weight[:, None] * gaussians.velocity).sum(0) / weight.sum()
