"""Rolling shutter: when each moving Gaussian is captured by a sensor that reads its lines one after another."""

from __future__ import annotations

import drjit as dr

from gof.core.cameras import Camera
from gof.render.backend import Array3f, Float, opaque
from gof.render.project import camera_axes

MIN_RELATIVE_SPEED = 0.1  # the readout overtakes a Gaussian with at least this part of its speed in the formula


def shutter_delay(
    position: Array3f, velocity: Array3f, camera: Camera, *, exact: bool = True, near: float = 0.01
) -> Float:
    """Delay after the start of the frame at which each Gaussian is read, s (N,); differentiable.

    t = t(p0) / (1 - grad t . v) (paper, supplement "Rolling Shutter"): p0 is the projection at the start of the frame,
    v its image velocity in px/s, t(p) = row_time * lines before p. `exact=False` returns t(p0).

    A Gaussian that moves along with the readout has no unique capture time as grad t . v approaches 1: 1 - grad t . v
    is held at or above 0.1, with gradient 0 there. t(p0) is held within one image length beyond the image; 0 at or
    behind the near plane.

    Args:
        position: (N,) world metres at the start of the frame (the time of its first line).
        velocity: (N,) m/s.
        camera: `row_time_s` and `readout` say how it reads.
    """
    axes, offset = camera_axes(camera)
    x, y, z = (dr.dot(axes[i], position) + offset[i] for i in range(3))
    seen = z > opaque(near)
    inv_z = 1.0 / dr.select(seen, z, 1.0)
    u, v = x * inv_z, y * inv_z
    du, dv = ((dr.dot(axes[i], velocity) - s * dr.dot(axes[2], velocity)) * inv_z for i, s in ((0, u), (1, v)))
    K = [[opaque(value) for value in row] for row in camera.K]
    along = 0 if camera.readout in ("left", "right") else 1
    pixels = (camera.width, camera.height)[along]
    if along == 0:
        line, speed = K[0][0] * u + K[0][1] * v + K[0][2] - 0.5, K[0][0] * du + K[0][1] * dv
    else:
        line, speed = K[1][1] * v + K[1][2] - 0.5, K[1][1] * dv
    if camera.readout in ("left", "up"):
        line, speed = (pixels - 1) - line, -speed
    row_time = opaque(camera.row_time_s)
    delay = row_time * dr.clip(line, -float(pixels), 2.0 * pixels)
    if exact:
        delay = delay / dr.maximum(1.0 - row_time * speed, MIN_RELATIVE_SPEED)
    return dr.select(seen, delay, 0.0)
