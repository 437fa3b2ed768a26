"""Cameras of a scene: on an arc around the fire, or each where it was placed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..core.checked_json import require
from ..core.rotations import rotation_matrices
from .timing import Vector

AROUND_DEG = tuple(range(0, 360, 45))
AROUND = (*(f"around_{angle:03d}" for angle in AROUND_DEG), "around_top")
"""Cameras around the fire, by their angle from the middle of the others, counter-clockwise seen from above."""
MOST_PIXELS = 65_536  # along a side; Blender renders no larger


@dataclass(frozen=True)
class Pose:
    """Place and direction of a camera, instead of its place on the arc."""

    position: Vector
    """Centre of the camera, world metres."""
    rotation: tuple[float, float, float, float]
    """Quaternion (w, x, y, z) from Blender's camera axes (x right, y up, looking along -z) to the world."""

    def __post_init__(self):
        length = math.hypot(*self.rotation)
        require(abs(length - 1) < 1e-3, "cameras.placed.rotation", "a unit quaternion", self.rotation)


@dataclass(frozen=True)
class Rig:
    """Cameras on a horizontal arc around the point they look at, or each where it was placed."""

    count: int = 3
    """Number of cameras, evenly spaced on the arc."""
    eval_count: int = 0
    """Additional cameras that no method may train on (role "eval"), between and above the others."""
    around_frames: int = 0
    """Frames, spread over the clip, that are also seen from all around, by cameras that no method may train on (role
    "around"): one every 45 degrees and one from above. 0: such cameras are not there."""
    arc_deg: float = 70.0
    """Angle between the first and the last camera."""
    azimuth_deg: float = -90.0
    """Direction from the look-at point to the middle of the arc, counter-clockwise from +X."""
    radius: float = 2.8
    """Horizontal distance from the look-at point, metres."""
    height: float = 0.9
    """Z of the camera centres, metres."""
    look_at: Vector = (0.0, 0.0, 0.75)
    """Point on every optical axis, world metres."""
    focal_mm: float = 50.0
    """Focal length for a sensor whose long side is 36 mm."""
    sensor_px: tuple[int, int] = (1280, 720)
    """Pixels of the sensor: (along its rows, number of rows)."""
    roll_deg: Literal[0, 90, 180, -90] = 90
    """Rotation of the camera body about its viewing direction, clockwise seen from behind. Images are stored
    upright, so 90 and -90 give portrait images whose columns are the sensor's rows."""
    placed: tuple[Pose, ...] = ()
    """Poses of the cameras for training, then of those for evaluation, when they do not stand on the arc. Poses are of
    the upright images: they do not contain the roll."""

    def __post_init__(self):
        require(self.count >= 1, "cameras.count", "at least 1", self.count)
        require(self.eval_count >= 0, "cameras.eval_count", "0 or more", self.eval_count)
        require(self.around_frames >= 0, "cameras.around_frames", "0 or more", self.around_frames)
        require(0.0 <= self.arc_deg < 360.0, "cameras.arc_deg", "in [0, 360)", self.arc_deg)
        require(self.radius > 0, "cameras.radius", "positive", self.radius)
        require(1 <= self.focal_mm <= 5000, "cameras.focal_mm", "in [1, 5000] mm", self.focal_mm)
        total = self.count + self.eval_count
        require(
            len(self.placed) in (0, total), "cameras.placed", "empty, or one pose for each camera", len(self.placed)
        )
        sides = min(self.sensor_px) >= 16 and max(self.sensor_px) <= MOST_PIXELS
        require(sides, "cameras.sensor_px", f"16 to {MOST_PIXELS} pixels each way", self.sensor_px)

    @property
    def portrait(self) -> bool:
        return self.roll_deg in (90, -90)

    @property
    def names(self) -> list[str]:
        """Return the names of all cameras: for training, for evaluation, around."""
        return [*self.whole_clip, *(AROUND if self.around_frames else ())]

    @property
    def whole_clip(self) -> list[str]:
        """Cameras that see every frame."""
        return [f"cam_{index}" for index in range(self.count)] + [f"eval_{index}" for index in range(self.eval_count)]


def role_of(name: str) -> str:
    """Return the role of a rig's camera in dataset.json, by its name."""
    return "around" if name in AROUND else "eval" if name.startswith("eval") else "train"


# ----------------------------------------------------------------
# Where the cameras of a rig stand and look, without Blender.

HALF_SENSOR = 18.0  # mm of the long side that a focal length refers to


def on_the_arc(rig: Rig) -> list[tuple[float, float, float]]:
    """Return world positions of cameras that are not placed one by one, those for evaluation last."""
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
    """Return world positions of the cameras around, as far from the point they look at as those for training, and as
    high."""
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
    """Return (C, 3) world metres of all cameras."""
    places = [pose.position for pose in rig.placed] if rig.placed else on_the_arc(rig)
    return np.array([*places, *(around(rig) if rig.around_frames else ())], float)


def seen(rig: Rig, points: np.ndarray) -> np.ndarray:
    """Return (C, N) whether a camera's picture has a point (N, 3) in it; things in between are ignored."""
    along = HALF_SENSOR / rig.focal_mm
    across = along * rig.sensor_px[1] / rig.sensor_px[0]
    half = np.array([across, along] if rig.portrait else [along, across])
    turned = np.einsum("cij,cnj->cni", _axes(rig), points[None] - positions(rig)[:, None])
    right, up, depth = turned[..., 0], turned[..., 1], -turned[..., 2]
    return (depth > 0) & (np.abs(right) <= half[0] * depth) & (np.abs(up) <= half[1] * depth)


def _axes(rig: Rig) -> np.ndarray:
    """Return (C, 3, 3) rows: right, up and backward of every camera, in the world."""
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
