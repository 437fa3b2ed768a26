"""What quantising costs: the page's Gaussians against the result's own, in dB, pixels and m/s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.look.player.opened import VISIBLE

LONGEST_SIDE = 720  # px of the pictures that are compared


@dataclass(frozen=True)
class Agreement:
    """The worst over some cameras and times.

    Attributes:
        psnr_db: of the pictures over black, clipped to what a screen shows; inf = equal.
        moved_px: how far a visible Gaussian's centre moved, in pixels of the camera.
        velocity_m_s: of all Gaussians, the largest difference of a component.
    """

    psnr_db: float
    moved_px: float
    velocity_m_s: float


def measure(
    own: TransientGaussians, drawn: TransientGaussians, cameras: list[Camera], times_s: list[float]
) -> Agreement:
    """Compare row by row the same Gaussians before and after."""
    from gof.render import render

    psnr, moved = [], [0.0]
    for camera in cameras:
        share = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
        small = camera.scaled(max(1, round(camera.width * share)), max(1, round(camera.height * share)))
        for time_s in times_s:
            first, second = (np.clip(render(g, small, time_s, shutter="global")["color"], 0, 1) for g in (own, drawn))
            error = float(np.mean((first - second) ** 2))
            psnr.append(-10 * np.log10(error) if error > 0 else np.inf)
            (before, opacity), (after, _) = own.at(time_s), drawn.at(time_s)
            seen = opacity >= VISIBLE
            shift = np.linalg.norm(camera.project(before[seen])[0] - camera.project(after[seen])[0], axis=-1)
            moved.append(float(np.nanmax(shift, initial=0.0)))
    speed = own.moving_gas - drawn.moving_gas
    return Agreement(min(psnr), max(moved), float(np.abs(speed).max(initial=0.0)))
