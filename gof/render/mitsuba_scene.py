"""The same Gaussians in Mitsuba: shape `ellipsoids`, integrator `volprim_rf_basic`. For cross-checks and for putting a
flame into a Mitsuba scene.

Mitsuba traces rays through the 3D Gaussians, so it differs from splatting in known ways: no affine approximation of the
perspective, Gaussians cut at an ellipsoid that shrinks with their opacity, ordered by where a ray enters their shell
instead of by their centre, alpha up to 0.9999 and rays stopped at transmittance 0.01, and a pixel is filtered by
sampling instead of by dilation.
"""

from __future__ import annotations

import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.host import extras

DILATION_SIGMA_PX = 0.3**0.5  # a Gaussian pixel filter this wide does what the 0.3 px^2 dilation stands for


def _mitsuba():
    mi = extras.load("mitsuba", "mitsuba", "the Mitsuba reference")
    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    return mi


def ellipsoids(gaussians: TransientGaussians, time_s: float, unit_m: float = 1.0) -> dict:
    """Return a `mi.load_dict` entry: the Gaussians at a time. Plain colours become harmonics of degree 0.

    Args:
        unit_m: metres per scene unit. The integrator steps 1e-4 units past a shell before it looks for the next one,
            and the shell intersection is not exact: away from Gaussians of about one unit, rays miss shells or hit them
            twice (half of the rays at 0.002 or 100 units). `scene` picks the unit.

    Raises:
        DataFormatError: no Gaussians (Mitsuba cannot hold an empty shape).
    """
    mi = _mitsuba()
    if len(gaussians) == 0:
        raise DataFormatError("Mitsuba's ellipsoids need at least one Gaussian")
    position, opacity = gaussians.at(time_s)
    color = gaussians.color
    coefficients = ((color - 0.5) / C0)[:, None] if color.ndim == 2 else color

    def tensor(values: np.ndarray):
        return mi.TensorXf(np.ascontiguousarray(values, np.float32))

    return {
        "type": "ellipsoids",
        "centers": tensor(position / unit_m),
        "scales": tensor(gaussians.scale / unit_m),
        "quaternions": tensor(gaussians.rotation[:, [1, 2, 3, 0]]),
        "opacities": tensor(opacity[:, None]),
        "sh_coeffs": tensor(coefficients.reshape(len(gaussians), -1)),
    }


def sensor(camera: Camera, spp: int = 16, filter_sigma: float = DILATION_SIGMA_PX, unit_m: float = 1.0) -> dict:
    """Return a `mi.load_dict` entry for a pinhole camera with square pixels.

    Args:
        filter_sigma: px of a Gaussian pixel filter, 0 = box.

    Raises:
        DataFormatError: fx and fy differ or the camera has skew; Mitsuba's perspective sensor has neither.
    """
    mi = _mitsuba()
    K, w, h = camera.K, camera.width, camera.height
    if abs(K[0, 0] - K[1, 1]) > 1e-6 * K[0, 0] or K[0, 1] != 0:
        raise DataFormatError(f"camera '{camera.name}': Mitsuba's perspective sensor needs fx = fy and no skew")
    to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba: x left, y up
    to_world[:3, 3] /= unit_m
    rfilter = {"type": "gaussian", "stddev": filter_sigma} if filter_sigma > 0 else {"type": "box"}
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(w / (2 * K[0, 0])))),
        "fov_axis": "x",
        "principal_point_offset_x": float(0.5 - K[0, 2] / w),
        "principal_point_offset_y": float(0.5 - K[1, 2] / h),
        "near_clip": 0.01 / unit_m,
        "far_clip": 1e4 / unit_m,
        "to_world": mi.ScalarTransform4f(to_world),
        "film": {"type": "hdrfilm", "width": w, "height": h, "rfilter": rfilter, "pixel_format": "rgb"},
        "sampler": {"type": "independent", "sample_count": spp},
    }


def scene(
    gaussians: TransientGaussians, camera: Camera, time_s: float, spp: int = 16, filter_sigma: float = DILATION_SIGMA_PX
):
    """Return a loaded Mitsuba scene of the Gaussians alone, colours unchanged (no sRGB conversion).

    The scene's unit is the geometric mean of the Gaussians' standard deviations; see `ellipsoids`.
    """
    unit_m = float(np.exp(np.log(gaussians.scale).mean())) if len(gaussians) else 1.0
    return _mitsuba().load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volprim_rf_basic", "max_depth": 512, "srgb_primitives": False},
            "sensor": sensor(camera, spp, filter_sigma, unit_m),
            "flame": ellipsoids(gaussians, time_s, unit_m),
        }
    )


def render_mitsuba(
    gaussians: TransientGaussians, camera: Camera, time_s: float, spp: int = 16, seed: int = 0
) -> np.ndarray:
    """(H, W, 3) float32 picture by ray tracing."""
    mi = _mitsuba()
    return np.array(mi.render(scene(gaussians, camera, time_s, spp), seed=seed))
