"""Light from display values: what a cloud must emit to look in the scene as in its reconstruction.

A reconstruction blends display values: a pixel that the cloud covers by the fraction W with mean colour c shows W c over
the dark. Cycles blends light and applies the view transform f to the sum. Because f is steep in the dark and flat in the
bright, f^-1(colour) of every Gaussian for itself would come out far too bright: thin places, and places whose Gaussians
differ in colour, most of all. So each Gaussian emits f^-1(W c) / W with W and c of a pixel it is seen in: there the sum
of the light is f^-1(W c), and the scene shows W c. Of several views the dimmest counts, because a Gaussian matters most
where little else is in front of or behind it: at the border of the flame, not in its core.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..io.gaussians_file import GaussianCloud

STOPS = np.linspace(-14.0, 8.0, 1024)  # linear greys measured, in powers of two
DIRECTIONS = 4  # horizontal views that W and c are taken from
MOST_SLICES = 64
LEAST_COVERAGE = 1e-4


@dataclass(frozen=True)
class ToneCurve:
    """A scene's view transform on greys: strictly increasing display values in [0, 1] and their linear light."""

    shown: np.ndarray
    linear: np.ndarray

    @classmethod
    def measure(cls, scene: bpy.types.Scene) -> ToneCurve:
        linear = np.concatenate([[0.0], 2.0**STOPS])
        shown = np.maximum.accumulate(display_values(linear, scene))
        # Flat parts of the curve (black, white) are reached at their first value.
        distinct, first = np.unique(shown, return_index=True)
        return cls(distinct, linear[first])

    def light(self, display: np.ndarray) -> np.ndarray:
        """Linear light >= 0 that is shown as `display` (any shape; clipped to [0, 1]); pure white gives a finite value.

        Exact channel by channel for Standard and Filmic; AgX shows saturated colours paler.
        """
        return np.interp(np.clip(display, 0, 1), self.shown, self.linear)


def emission(cloud: GaussianCloud, curve: ToneCurve) -> np.ndarray:
    """Light (N, 3) float32, finite, >= 0, that each Gaussian emits per unit of opacity.

    W and c are those at its brightest time (to a time slice of one lifetime), in square pixels of two standard deviations.
    """
    spread = cloud.scale.astype(np.float64).prod(1) ** (2 / 3)  # product of the two standard deviations seen in a view
    pixel = 2 * float(np.median(np.sqrt(spread)))
    fading = cloud.dynamic & np.isfinite(cloud.t_sigma)
    lifetime = 1.0
    if fading.any():
        lifetime = max(float(np.median(cloud.t_sigma[fading])), float(np.ptp(cloud.t_mu[fading])) / MOST_SLICES)
    slices = np.round(np.where(fading, cloud.t_mu, 0.0) / lifetime)
    light = np.full((len(cloud), 3), np.inf)
    for number in np.unique(slices):
        age = np.where(cloud.dynamic, number * lifetime - cloud.t_mu.astype(np.float64), 0.0)
        alpha = cloud.opacity * np.exp(-0.5 * (age / cloud.t_sigma) ** 2)
        alive = np.flatnonzero((alpha > 1e-3) | (slices == number))
        asked = slices[alive] == number
        place = cloud.position[alive] + age[alive, None] * cloud.velocity[alive]
        depth = 2 * np.pi * (alpha * spread)[alive] / pixel**2
        for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            across = place[:, :2] @ [np.cos(angle), np.sin(angle)]
            shown, covered = _pixels(np.floor(np.column_stack([across, place[:, 2]]) / pixel), depth, cloud.color[alive])
            here = (curve.light(shown) / covered[:, None])[asked]
            light[alive[asked]] = np.minimum(light[alive[asked]], here)
    return light.astype(np.float32)


def _pixels(index: np.ndarray, depth: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Display value W c (N, 3) and coverage W (N,) of the pixel that each Gaussian falls into.

    Args:
        index: (N, 2) whole pixel coordinates; depth: (N,) optical depth of each Gaussian spread over a pixel;
        color: (N, 3) display values.
    """
    _, owner = np.unique(index, axis=0, return_inverse=True)
    total = np.bincount(owner, depth)
    covered = np.clip(-np.expm1(-total), LEAST_COVERAGE, 1.0)
    sums = np.column_stack([np.bincount(owner, depth * color[:, channel]) for channel in range(3)])
    mean = sums / np.maximum(total, 1e-12)[:, None]  # a pixel of vanished Gaussians only: dark
    return (np.clip(mean, 0, 1) * covered[:, None])[owner], covered[owner]


def display_values(linear: np.ndarray, scene: bpy.types.Scene) -> np.ndarray:
    """Display values (N,) in [0, 1] that the scene's view transform gives linear greys (N,)."""
    ramp = bpy.data.images.new("tone curve", len(linear), 1, float_buffer=True, is_data=False)
    ramp.colorspace_settings.name = "Linear Rec.709"
    ramp.pixels.foreach_set(np.column_stack([linear] * 3 + [np.ones(len(linear))]).ravel().astype(np.float32))
    settings = scene.render.image_settings
    kept = {key: getattr(settings, key) for key in ("file_format", "color_mode", "color_depth")}
    seen = None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ramp.png"
        try:
            settings.file_format = "PNG"
            settings.color_mode, settings.color_depth = "RGB", "16"
            ramp.save_render(str(file), scene=scene)
            seen = bpy.data.images.load(str(file))
            seen.colorspace_settings.name = "Non-Color"
            pixels = np.empty(len(linear) * 4, np.float32)
            seen.pixels.foreach_get(pixels)
        finally:
            for key, value in kept.items():
                setattr(settings, key, value)
            for image in (ramp, seen):
                if image is not None:
                    bpy.data.images.remove(image)
    return pixels.reshape(-1, 4)[:, 0].astype(np.float64)
