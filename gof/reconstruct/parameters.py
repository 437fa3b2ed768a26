"""Transient Gaussians as numbers without bounds, which an optimiser may move freely, and back.

Raw parameters: "x0", "velocity" unchanged; "t_mu" after the clip's start; "log_t_sigma"; the logits "opacity" and
"scale" (between 0.1 and 3 voxels); "rotation", a quaternion of any length; and of the colour either "color", as it is,
or its logits, "color_logit".

A colour of logits is divided by its brightest channel, which then is 1: a Gaussian hides no more than it shines, as
fire does, and a fainter one is a thinner one. A colour that is free to be dark hides the light behind it
where the given cameras look, and what is hidden may be anything; one without a bound shines too much where another one
takes it away again. Both are seen from the side.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.reconstruct.palette import Palette
from gof.reconstruct.seeds import SCALE_MAX, SCALE_MIN
from gof.render import Splats, shutter_delay, transient_state
from gof.render.backend import Array3f, Array4f, Float, floats, opaque
from gof.render.rasterizer import MIN_ALPHA
from gof.render.scene import columns

OPACITY_EPS = 1e-4  # logits stay finite
BLACK = 1e-7  # a brightest channel below it, whose logit is below -16, is not divided by
FAINTEST = 0.99 * MIN_ALPHA  # what is fainter is not drawn, however its opacity is rounded
PLATE = "plate_"  # and the camera's number: raw parameters of a plate
GROUP = 16  # rows: a cache line of each column
MOVING = ("x0", "velocity", "t_mu", "log_t_sigma", "opacity")  # what says where one is when, and how much of it

Raw = Mapping[str, Any]  # name -> Dr.Jit array


def rows(x: Array3f | Array4f | Float) -> np.ndarray:
    """Dr.Jit to (N, 3), (N, 4) or (N,), a copy: the reverse of `columns`, and like that without kernels."""
    x = dr.detach(x)
    dr.eval(x)
    return np.stack([c.numpy() for c in x], -1) if dr.depth_v(x) > 1 else np.array(x.numpy())


def to_raw(
    gaussians: TransientGaussians, voxel_size: float, start_s: float, color_of_light: bool = True
) -> dict[str, Any]:
    """Return the raw parameters of Gaussians.

    Args:
        voxel_size: m.   start_s: of the clip, s.   color_of_light: whether the brightest channel is 1.
    """
    color = {"color_logit": _logit(gaussians.color)} if color_of_light else {"color": gaussians.color}
    scale = (gaussians.scale / voxel_size - SCALE_MIN) / (SCALE_MAX - SCALE_MIN)
    return {
        "x0": columns(gaussians.position, Array3f),
        "velocity": columns(gaussians.velocity, Array3f),
        "t_mu": floats(gaussians.t_mu - np.float32(start_s)),
        "log_t_sigma": floats(np.log(gaussians.t_sigma)),
        "scale": columns(_logit(scale), Array3f),
        "rotation": columns(gaussians.rotation, Array4f),
        "opacity": floats(_logit(gaussians.opacity)),
        **{name: columns(values, Array3f) for name, values in color.items()},
    }


def per_gaussian(raw: Raw) -> list[str]:
    """Names of the parameters that every Gaussian has one of; the others are the plates'."""
    return [name for name in raw if not name.startswith(PLATE)]


def from_raw(raw: Raw, voxel_size: float, start_s: float) -> TransientGaussians:
    """Return the Gaussians of raw parameters, all of them dynamic; args as `to_raw`."""
    return TransientGaussians(
        position=rows(raw["x0"]),
        velocity=rows(raw["velocity"]),
        t_mu=rows(raw["t_mu"]) + np.float32(start_s),
        t_sigma=rows(dr.exp(raw["log_t_sigma"])),
        scale=rows(_scale(raw, voxel_size)),
        rotation=rows(raw["rotation"]),
        opacity=rows(_sigmoid(raw["opacity"])),
        color=rows(_color(raw)),
        dynamic=np.ones(dr.width(raw["t_mu"]), bool),
    )


def splats(raw: Raw, voxel_size: float, time_s: float | Float, camera: Camera) -> Splats:
    """Return the splats of a frame whose first line is read at `time_s` after the clip's start; differentiable.

    time_s: one for all, or (N,).
    """
    position, opacity = _state(raw, voxel_size, time_s, camera)
    color = _color(raw)
    return Splats(position, raw["rotation"], _scale(raw, voxel_size), opacity, [color.x, color.y, color.z])


def recolor(raw: Raw, palette: Palette, pull: float) -> Array3f:
    """Return logits of colours that are by the share `pull` nearer to the palette's, see `Palette.find`.

    raw: with "color_logit".
    """
    logit = rows(raw["color_logit"])
    color = rows(_sigmoid(raw["color_logit"]))
    brightest = color.max(1, keepdims=True)
    wanted = _logit(palette.find(color) * brightest)
    return columns(np.where(brightest > BLACK, logit + pull * (wanted - logit), logit).astype(np.float32), Array3f)


def alight(raw: Raw, voxel_size: float, times_s: np.ndarray, camera: Camera) -> np.ndarray:
    """(K, N) bool: which Gaussians `splats` can draw at each of K times. Most live at other times."""
    moving = {name: dr.detach(raw[name]) for name in MOVING}
    shown = [_state(moving, voxel_size, time_s, camera)[1] > FAINTEST for time_s in times_s.tolist()]
    dr.eval(shown)  # in one kernel
    return np.stack([mask.numpy() for mask in shown])


def _state(raw: Raw, voxel_size: float, time_s: float | Float, camera: Camera) -> tuple[Array3f, Float]:
    """Position and opacity of each Gaussian when the camera reads it."""
    time_s = time_s if isinstance(time_s, Float) else opaque(time_s)
    motion = raw["x0"], raw["velocity"], raw["t_mu"], dr.exp(raw["log_t_sigma"]), _sigmoid(raw["opacity"])
    position, opacity = transient_state(*motion, time_s)
    if camera.row_time_s > 0:
        delay = shutter_delay(position, raw["velocity"], camera, near=voxel_size)
        position, opacity = transient_state(*motion, delay + time_s)
    return position, opacity


def _scale(raw: Raw, voxel_size: float) -> Array3f:
    # A sigmoid instead of an exponential keeps flame Gaussians small (paper, "Implementation Details").
    return voxel_size * (SCALE_MIN + (SCALE_MAX - SCALE_MIN) / (1 + dr.exp(-raw["scale"])))


def _color(raw: Raw) -> Array3f:
    if "color" in raw:
        return raw["color"]
    color = _sigmoid(raw["color_logit"])
    return color / dr.maximum(dr.maximum(dr.maximum(color.x, color.y), color.z), BLACK)


def _sigmoid(x: Float) -> Float:
    return 0.5 + 0.5 * dr.tanh(0.5 * x)  # the derivative of 1 / (1 + exp(-x)) is NaN below -88


def _logit(x: np.ndarray) -> np.ndarray:
    x = np.clip(x.astype(np.float64), OPACITY_EPS, 1 - OPACITY_EPS)
    return (np.log(x) - np.log1p(-x)).astype(np.float32)
