"""How far Gaussians of a file are from those it was made of: pictures, places and velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import VISIBLE, TransientGaussians

SIDE_PX, FOCAL_PX = 400, 800.0
INSTANTS = (0.25, 0.5, 0.75)  # of the clip
LIT = 0.02  # display value from which a pixel shows something


@dataclass(frozen=True)
class Distance:
    """Length of a difference over all Gaussians.

    Attributes:
        rms, most: mm, or mm/s.
    """

    rms: float
    most: float

    @classmethod
    def between(cls, before: np.ndarray, after: np.ndarray) -> Distance:
        """From (N, 3) in metres or m/s, N > 0."""
        length = 1e3 * np.linalg.norm(after - before, axis=1)
        return cls(float(np.sqrt(np.mean(length**2))), float(length.max()))


@dataclass(frozen=True)
class Loss:
    """Differences of a file from what it was made of.

    Attributes:
        place: of Gaussians.
        velocity, gas_velocity: of those that move; None where one side has none. Background rests.
        psnr: dB of display values within [0, 1], where either shows something; inf where nothing differs, None where
            nothing is seen.
    """

    place: Distance
    velocity: Distance | None
    gas_velocity: Distance | None
    psnr: float | None

    def __str__(self) -> str:
        words = [f"places are {self.place.rms:.2g} mm off (rms; at most {self.place.most:.2g})"]
        for off, label in ((self.velocity, "velocities"), (self.gas_velocity, "those of the gas")):
            if off is not None:
                words.append(f"{label} {off.rms:.2g} mm/s (rms; at most {off.most:.2g})")
        return f"compared with what was written: {', '.join(words)}; pictures from the front " + (
            "show nothing then" if self.psnr is None else f"agree to {self.psnr:.1f} dB"
        )


def measure_loss(before: TransientGaussians, after: TransientGaussians, start_s: float, end_s: float) -> Loss:
    """Compare Gaussians with the same ones before, row by row; pictures from the front, at three instants of the clip.

    Args:
        before, after: the same count, in the same order.
        start_s, end_s: first and last second of the clip.
    """
    moving = before.dynamic
    velocity = gas_velocity = None
    if moving.any():
        velocity = Distance.between(before.velocity[moving], after.velocity[moving])
        if before.gas_velocity is not None and after.gas_velocity is not None:
            gas_velocity = Distance.between(before.moving_gas[moving], after.moving_gas[moving])
    times_s = [start_s + share * (end_s - start_s) for share in INSTANTS]
    psnr = picture_psnr(before, {time_s: after for time_s in times_s})
    return Loss(Distance.between(before.position, after.position), velocity, gas_velocity, psnr)


def picture_psnr(before: TransientGaussians, after: dict[float, TransientGaussians]) -> float | None:
    """Return dB as `Loss.psnr`.

    Args:
        after: the Gaussians that are to look as `before` does at a time, by that time, s.
    """
    from gof.render import render

    squares = []
    for time_s, other in after.items():
        camera = _front(before, time_s)
        if camera is None:
            continue
        pictures = [np.clip(render(g, camera, time_s)["color"], 0, 1) for g in (before, other)]
        lit = np.maximum(*pictures).max(-1) > LIT
        squares.append(((pictures[0] - pictures[1])[lit] ** 2).reshape(-1))
    off = np.concatenate(squares) if squares else np.zeros(0)
    if not len(off):
        return None
    return float(-10 * np.log10(off.mean())) if off.any() else float("inf")


def _front(g: TransientGaussians, time_s: float) -> Camera | None:
    """Return a camera that looks along +y at most of what is seen at a time; None where nothing is."""
    position, opacity = g.at(time_s)
    seen = position[opacity >= VISIBLE]
    if not len(seen):
        return None
    low, high = np.percentile(seen.astype(np.float64), [2, 98], axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)
    rows = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    pose = np.eye(4)
    pose[:3, :3] = rows
    pose[:3, 3] = -rows @ (middle - [0, 2.5 * reach * FOCAL_PX / (SIDE_PX / 2), 0])
    K = np.array([[FOCAL_PX, 0, SIDE_PX / 2], [0, FOCAL_PX, SIDE_PX / 2], [0, 0, 1]])
    return Camera("front", SIDE_PX, SIDE_PX, K, pose)
