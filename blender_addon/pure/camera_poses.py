"""Where the cameras of a rig stand and look, without Blender."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..core.rotations import rotation_matrices
from .rig import AROUND_DEG

if TYPE_CHECKING:
    from .rig import Rig

HALF_SENSOR = 18.0  # mm of the long side that a focal length refers to


def on_the_arc(rig: Rig) -> list[tuple[float, float, float]]:
    """World positions of cameras that are not placed one by one, those for evaluation last."""
    step = rig.arc_deg / (rig.count - 1) if rig.count > 1 else 0.0
    first = rig.azimuth_deg - (rig.arc_deg / 2 if rig.count > 1 else 0.0)
    places = [(first + index * step, rig.height) for index in range(rig.count)]
    # For evaluation: in the middle of equal parts of the arc, a tenth of the distance higher.
    part = rig.arc_deg / max(rig.eval_count, 1)
    start = rig.azimuth_deg - rig.arc_deg / 2
    places += [(start + (index + 0.5) * part, rig.height + 0.1 * rig.radius) for index in range(rig.eval_count)]
    x, y, _ = rig.look_at
    return [
        (x + rig.radius * math.cos(math.radians(angle)), y + rig.radius * math.sin(math.radians(angle)), height)
        for angle, height in places
    ]


def around(rig: Rig) -> list[tuple[float, float, float]]:
    """World positions of the cameras around, as far from the point they look at as those for training, and as high."""
    place = np.array([pose.position for pose in rig.placed] or on_the_arc(rig), float)[: rig.count]
    x, y, z = rig.look_at
    radius = float(np.hypot(place[:, 0] - x, place[:, 1] - y).mean()) or rig.radius
    height = float(place[:, 2].mean())
    middle = math.radians(rig.azimuth_deg)
    if rig.placed:
        toward = (place[:, :2] - [x, y]).mean(0)
        middle = math.atan2(toward[1], toward[0]) if toward.any() else middle
    angles = [middle + math.radians(angle) for angle in AROUND_DEG]
    ring = [(x + radius * math.cos(angle), y + radius * math.sin(angle), height) for angle in angles]
    # Straight down leaves open which way is up in the picture; a hair towards the middle camera settles it.
    down = math.hypot(radius, height - z)
    return [*ring, (x + 0.01 * down * math.cos(middle), y + 0.01 * down * math.sin(middle), z + down)]


def positions(rig: Rig) -> np.ndarray:
    """(C, 3) world metres of all cameras."""
    places = [pose.position for pose in rig.placed] if rig.placed else on_the_arc(rig)
    return np.array([*places, *(around(rig) if rig.around_frames else ())], float)


def seen(rig: Rig, points: np.ndarray) -> np.ndarray:
    """(C, N) whether a camera's picture has a point (N, 3) in it; what stands between is not asked."""
    along = HALF_SENSOR / rig.focal_mm
    across = along * rig.sensor_px[1] / rig.sensor_px[0]
    half = np.array([across, along] if rig.portrait else [along, across])
    turned = np.einsum("cij,cnj->cni", _axes(rig), points[None] - positions(rig)[:, None])
    right, up, depth = turned[..., 0], turned[..., 1], -turned[..., 2]
    return (depth > 0) & (np.abs(right) <= half[0] * depth) & (np.abs(up) <= half[1] * depth)


def _axes(rig: Rig) -> np.ndarray:
    """(C, 3, 3) rows: right, up and backward of every camera, in the world."""
    back = positions(rig) - np.array(rig.look_at, float)
    length = np.linalg.norm(back, axis=1, keepdims=True)
    back = np.divide(back, length, out=np.tile([0.0, -1.0, 0.0], (len(back), 1)), where=length > 0)
    right = np.cross([0.0, 0.0, 1.0], back)
    level = np.linalg.norm(right, axis=1, keepdims=True)
    right = np.divide(right, level, out=np.tile([1.0, 0.0, 0.0], (len(back), 1)), where=level > 1e-9)  # straight down
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    if rig.placed:
        placed = np.array([pose.rotation for pose in rig.placed], float)
        axes[: len(placed)] = rotation_matrices(placed).transpose(0, 2, 1)
    return axes
