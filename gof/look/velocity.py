"""Velocities as pictures: what moves where on the screen, by the reconstruction and by the truth at its Gaussians.

Also parallel to a picture in m/s, of a result and of the truth, and one scale for all.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.colour import direction_colors
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.expectation import expected_velocity
from gof.evaluate.intervals import weighted_quantile
from gof.evaluate.screen_motion import ScreenVelocity, sideways_velocity

GROUND = np.array([0.11, 0.11, 0.12])  # display colour where nothing is
ARROWS_ACROSS = 14
MIN_ALPHA = 0.15  # below this no arrow is drawn: the mean velocity of almost nothing


def living(gaussians: TransientGaussians, time_s: float) -> TransientGaussians:
    """Return the dynamic Gaussians that can be seen at a time (opacity above 1/512, half a step of an 8-bit
    picture)."""
    _, opacity = gaussians.at(time_s)
    return gaussians[gaussians.dynamic & (opacity > 1 / 512)]


def draw(velocity: ScreenVelocity, longest: float, scale: int = 2) -> np.ndarray:
    """Return a panel (scale H, scale W, 3) uint8: direction colours over a dark ground, arrows on a grid.

    Args:
        longest: speed of full brightness, in the velocity's unit; an arrow of that speed reaches its neighbour.
        scale: whole factor by which the panel is larger than the picture.
    """
    height, width = velocity.alpha.shape
    panel = cv2.resize(colours(velocity, longest), (scale * width, scale * height), interpolation=cv2.INTER_CUBIC)
    for tail, head in arrows(velocity, longest):
        start, end = ([round(c * scale * 16) for c in point.tolist()] for point in (tail, head))  # 1/16 px
        cv2.arrowedLine(panel, start, end, (255, 255, 255), 1, cv2.LINE_AA, shift=4, tipLength=0.35)
    return panel


def colours(velocity: ScreenVelocity, longest: float) -> np.ndarray:
    """Return (H, W, 3) uint8: direction colours over a dark ground; `longest` as in `draw`."""
    alpha = velocity.alpha[..., None]
    color = direction_colors(velocity.flow, longest) * alpha + GROUND * (1 - alpha)
    return (color * 255 + 0.5).astype(np.uint8)


def arrows(velocity: ScreenVelocity, longest: float, across: int = ARROWS_ACROSS) -> np.ndarray:
    """Return (A, 2, 2) tails and heads in px (x, y), on a grid with `across` places from left to right; faint ones left
    out.

    Args:
        longest: as in `draw`.
    """
    height, width = velocity.alpha.shape
    spacing_px = width / across
    found = []
    for y in np.arange(spacing_px / 2, height, spacing_px):
        for x in np.arange(spacing_px / 2, width, spacing_px):
            i, j = int(y), int(x)
            if velocity.alpha[i, j] < MIN_ALPHA:
                continue
            arrow = velocity.flow[i, j] / max(longest, 1e-12) * spacing_px
            size = float(np.hypot(*arrow))
            if size < 0.1 * spacing_px:
                continue
            arrow *= min(1.0, 1.2 * spacing_px / size)
            found.append((np.array([x, y]) - arrow / 2, np.array([x, y]) + arrow / 2))
    return np.array(found).reshape(-1, 2, 2)


def legend(size: int = 160) -> np.ndarray:
    """Return the colour wheel (size, size, 4) uint8, corners transparent; a pixel's colour is that of its offset."""
    c = (np.arange(size) + 0.5) / size * 2 - 1
    offset = np.stack(np.meshgrid(c, c), -1)
    alpha = np.clip((1 - np.linalg.norm(offset, axis=-1)) * size / 2, 0, 1)
    return (np.concatenate([direction_colors(offset, 1.0), alpha[..., None]], -1) * 255 + 0.5).astype(np.uint8)


def of_result(gaussians: TransientGaussians, camera: Camera, time_s: float) -> ScreenVelocity:
    """Return the velocity of the gas by the dynamic Gaussians that live then."""
    return sideways_velocity(living(gaussians, time_s), camera, time_s)


def true_there(gaussians: TransientGaussians, dataset: Dataset, camera: Camera, time_s: float) -> ScreenVelocity:
    """Return the simulated velocity at the same Gaussians, the mean over each one's extent; the dataset has to know
    it."""
    alive = living(gaussians, time_s)
    centre, _ = alive.at(time_s)
    true = expected_velocity(dataset.velocity.at(time_s), centre, alive.scale, alive.rotation).mean
    return sideways_velocity(alive, camera, time_s, true)


def fastest(fields: Sequence[ScreenVelocity]) -> float:
    """Return the speed of full brightness for all of them: the 98th percentile by opacity; > 0."""
    speed = np.concatenate([np.linalg.norm(one.flow, axis=-1).ravel() for one in fields])
    weight = np.concatenate([one.alpha.ravel() for one in fields])
    return max(float(weighted_quantile(speed, weight, 0.98)), 1e-9) if weight.any() else 1.0


def unit(dataset: Dataset) -> str:
    """Return the unit of speeds on pictures of a dataset, whose poses may have no known length."""
    return "m/s" if dataset.description.in_metres else "units/s"
