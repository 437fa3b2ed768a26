"""A dataset folder without Blender: a bright blob that rises before a wall and a floor, with plates and their depth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gof.dataset import CameraEntry, DatasetDescription, Splits
from tests.conftest import arc

WIDTH, HEIGHT, FRAMES, TEST = 48, 80, 8, (4,)


def write(root: Path) -> Path:
    """Three cameras, 8 frames of 10 ms, frame 4 held out; then every layout that trainings here read."""
    dataset(root)
    from gof_benchmark import views

    for name in ("dnerf", "points", "n3v", "multipleview", "hypernerf", "nerfds", "freetimegs"):
        views.write(name, root)
    return root


def dataset(root: Path) -> Path:
    import OpenEXR

    cameras = arc(3, radius=2.5, target=(0, 0, 0.7), width=WIDTH, height=HEIGHT, focal_px=100.0)
    entries = []
    for camera in cameras:
        columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        rays = camera.unproject(pixels, np.ones(len(pixels))) - camera.position
        with np.errstate(divide="ignore"):
            wall, floor = (2.0 - camera.position[1]) / rays[:, 1], -camera.position[2] / rays[:, 2]
        depth = np.minimum(np.where(wall > 0, wall, 1e10), np.where(floor > 0, floor, 1e10))
        place = camera.position + rays * depth[:, None]
        checks = (np.floor(4 * place).sum(1) % 2).reshape(HEIGHT, WIDTH)
        plate = np.uint8(60 + 60 * checks)[..., None] * np.ones(3, np.uint8)
        files = f"cameras/{camera.name}"
        entry = CameraEntry.of(camera, rgb=f"{files}/rgb/{{frame:06d}}.png", static=f"static/{camera.name}.png")
        entries.append(entry)
        (root / files / "rgb").mkdir(parents=True)
        (root / "static").mkdir(exist_ok=True)
        cv2.imwrite(str(root / entry.static), plate)
        head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(head, {"Z": depth.reshape(HEIGHT, WIDTH).astype(np.float32)}) as file:
            file.write(str(root / f"static/{camera.name}.exr"))
        for frame in range(FRAMES):
            centre, _ = camera.project(blob(frame)[None])
            distance = ((columns - centre[0, 0]) ** 2 + (rows - centre[0, 1]) ** 2) / 6.0**2
            light = np.exp(-distance)[..., None] * [40, 120, 255]  # blue, green, red
            cv2.imwrite(str(root / entry.rgb.format(frame=frame)), np.uint8(np.clip(plate + light, 0, 255)))
    train = tuple(k for k in range(FRAMES) if k not in TEST)
    times = tuple(0.01 * k for k in range(FRAMES))
    DatasetDescription(name="made-up", time_s=times, cameras=tuple(entries), splits=Splits(train, TEST)).write(root)
    return root


def blob(frame: int) -> np.ndarray:
    """(3,) m: where the flame is."""
    return np.array([0.0, 0.0, 0.5 + 0.05 * frame])
