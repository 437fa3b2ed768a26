"""Motion on the screen: what Gaussians' velocities are there, drawn in place of their colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians


class ScreenVelocity(NamedTuple):
    flow: np.ndarray  # (H, W, 2) px/s, or m/s; opacity-weighted mean along the pixel's ray; 0 where alpha is 0
    alpha: np.ndarray  # (H, W) in [0, 1), of what is dynamic


def screen_velocity(
    gaussians: TransientGaussians, camera: Camera, time_s: float, velocity: np.ndarray | None = None
) -> ScreenVelocity:
    """Return the one of `screen_velocities`; without a velocity, that of the gas as the Gaussians say it."""
    v = gaussians.moving_gas if velocity is None else velocity
    return screen_velocities(gaussians, camera, time_s, [v])[0]


def screen_velocities(
    gaussians: TransientGaussians, camera: Camera, time_s: float, velocities: Sequence[np.ndarray]
) -> list[ScreenVelocity]:
    """Render velocities J v instead of the Gaussians' colour, all of them in one pass.

    Args:
        gaussians: Gaussians (N); static ones hide what is behind them, and count for nothing.
        velocities: at most four, each (N, 3) m/s; where they are drawn does not change.
    Returns:
        One for each; J is the derivative of the pixel with respect to the world point, at each centre.
    """
    centre, _ = gaussians.at(time_s)
    jacobian = camera.projection_jacobian(centre)
    flows = [np.einsum("nij,nj->ni", jacobian, v.astype(np.float64)) for v in velocities]
    return _mean_along_rays(gaussians, camera, time_s, np.nan_to_num(flows))  # behind the camera: not drawn anyway


def sideways_velocity(
    gaussians: TransientGaussians, camera: Camera, time_s: float, velocity: np.ndarray | None = None
) -> ScreenVelocity:
    """Return the part of the gas' velocity that is parallel to the picture, m/s: the same from near and from far.

    Args:
        velocity: (N, 3) m/s to show in place of their own; where they are drawn does not change.
    """
    v = gaussians.moving_gas if velocity is None else velocity
    return _mean_along_rays(gaussians, camera, time_s, (v @ camera.world_to_camera[:2, :3].T)[None])[0]


def _mean_along_rays(
    gaussians: TransientGaussians, camera: Camera, time_s: float, values: np.ndarray
) -> list[ScreenVelocity]:
    """Return K times two values (K, N, 2) of each dynamic Gaussian, drawn instead of its colour."""
    shape = camera.height, camera.width
    if len(gaussians) == 0:
        return [ScreenVelocity(np.zeros((*shape, 2)), np.zeros(shape)) for _ in values]
    from gof.render.backend import floats
    from gof.render.rasterizer import render_splats, splats_at
    from gof.render.scene import require_finite_splats

    shown = [
        floats(column)
        for column in np.where(gaussians.dynamic, np.moveaxis(values, 2, 1), 0).reshape(-1, len(gaussians))
    ]
    splats = replace(splats_at(gaussians, camera, time_s), color=shown)
    require_finite_splats(splats)
    frame = render_splats(splats, camera, dynamic=floats(gaussians.dynamic))
    assert frame.dynamic_alpha is not None, "weights were given"
    alpha = np.array(frame.dynamic_alpha.numpy()).reshape(shape)
    sums = np.stack([plane.numpy() for plane in frame.color]).reshape(len(values), 2, *shape)
    seen = alpha > 1e-4
    means = np.where(seen, sums / np.where(seen, alpha, 1), 0)
    return [ScreenVelocity(np.moveaxis(mean, 0, -1), alpha) for mean in means]
