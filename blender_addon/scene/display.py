"""Light from display values: what a cloud must emit to look in the scene as in its reconstruction.

A reconstruction blends display values: a pixel that the cloud covers by the fraction W with mean colour c shows W c
over the dark. Cycles blends light and applies the view transform f to the sum. Because f is steep in the dark and flat
in the bright, f^-1(colour) of every Gaussian for itself would come out far too bright: thin places, and places whose
Gaussians differ in colour, most of all. So each Gaussian emits f^-1(W c) / W with W and c of a pixel it is seen in:
there the sum of the light is f^-1(W c), and the scene shows W c. The dimmest of several views counts, because a
Gaussian matters most where little else is in front of or behind it: at the border of the flame, not in its core. A few
rounds of correction then scale every Gaussian's light by the mean of wanted over shown light of the pixels it is in,
over all views and times.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..pure.io.cloud import GaussianCloud
from . import compat

STOPS = np.linspace(-14.0, 8.0, 1024)  # linear greys measured, in powers of two
DIRECTIONS = 4  # horizontal views that W and c are taken from
MOST_SLICES = 64
LEAST_COVERAGE = 1e-4
LEAST_OPACITY = 1e-3  # of a Gaussian that still counts in a picture
MOST_ROUNDS, ROUNDS_BUDGET = 3, 600_000  # of correction: as many as the budget of Gaussians allows
MOST_PIXELS = 1 << 22  # of a picture that is summed as an array


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

    W and c are those at its brightest time (to a time slice of one lifetime), in square pixels of two standard
    deviations.
    """
    light = np.full((len(cloud), 3), np.inf, np.float32)
    for picture in _pictures(cloud):
        shown, covered, _ = picture.blend(cloud.color)
        here = (curve.light(np.clip(shown, 0, 1) * covered) / covered)[picture.owner[picture.asked]]
        rows = picture.rows[picture.asked]
        light[rows] = np.minimum(light[rows], here)
    for _ in range(min(MOST_ROUNDS, ROUNDS_BUDGET // len(cloud))):
        _correct(light, cloud, curve)
    return light


def _correct(light: np.ndarray, cloud: GaussianCloud, curve: ToneCurve) -> None:
    """Scale each Gaussian's light by what the pictures lack where it is seen, weighted by its share of their pixels."""
    lacking, weight = np.zeros_like(light, np.float64), np.zeros(len(light))
    for picture in _pictures(cloud):
        shown, covered, share = picture.blend(cloud.color)
        wanted = curve.light(np.clip(shown, 0, 1) * covered)
        ratio = wanted / np.maximum(picture.blend(light)[0] * covered, 1e-9)
        lacking[picture.rows] += share[:, None] * ratio[picture.owner]
        weight[picture.rows] += share
    light *= np.clip(lacking / np.maximum(weight, 1e-12)[:, None], 0.1, 10)


@dataclass(frozen=True)
class _Picture:
    """Gaussians in the pixels of one view at one time."""

    rows: np.ndarray  # (M,) which Gaussians
    asked: np.ndarray  # which of the M are at their brightest time
    owner: np.ndarray  # (M,) pixel of each
    depth: np.ndarray  # (M,) optical depth of each, spread over a pixel

    def blend(self, color: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean (P, 3) of colours (N, 3) in each of P pixels, coverage (P, 1), and each Gaussian's share (M,) of
        it."""
        total = np.bincount(self.owner, self.depth)
        sums = np.column_stack(
            [np.bincount(self.owner, self.depth * color[self.rows, channel]) for channel in range(3)]
        )
        covered = np.clip(-np.expm1(-total), LEAST_COVERAGE, 1.0)
        part = covered / np.maximum(total, 1e-12)
        # a pixel of vanished Gaussians only: dark
        return sums / np.maximum(total, 1e-12)[:, None], covered[:, None], self.depth * part[self.owner]


def _pictures(cloud: GaussianCloud) -> Iterator[_Picture]:
    """Yield the cloud at times one lifetime apart, in horizontal views all around."""
    spread = cloud.scale.astype(np.float64).prod(1) ** (2 / 3)  # product of the two standard deviations seen in a view
    pixel = 2 * float(np.median(np.sqrt(spread)))
    first, last = _seen(cloud)
    bounded = np.isfinite(first)
    brightest = np.where(bounded, cloud.t_mu, 0.0)
    lifetime = 1.0
    if bounded.any():
        lifetime = max(
            float(np.median((last - first)[bounded])) / 7, float(np.ptp(brightest[bounded])) / MOST_SLICES, 1e-9
        )
    slices = np.round(brightest / lifetime)
    for number in np.unique(slices):
        time = np.float32(number * lifetime)
        alive = np.flatnonzero(((first <= time) & (time <= last)) | (slices == number))
        asked = np.flatnonzero(slices[alive] == number)
        age = np.where(cloud.dynamic[alive], time - cloud.t_mu[alive], np.float32(0))
        alpha = cloud.opacity[alive] * np.exp(-0.5 * np.minimum(np.abs(age) / cloud.t_sigma[alive], 40) ** 2)
        place = (cloud.position[alive] + age[:, None] * cloud.velocity[alive]) / np.float32(pixel)
        depth = (2 * np.pi * alpha * spread[alive]) / pixel**2
        for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            across = place[:, 0] * np.float32(np.cos(angle)) + place[:, 1] * np.float32(np.sin(angle))
            yield _Picture(alive, asked, _pixel_numbers(across, place[:, 2]), depth)


def _seen(cloud: GaussianCloud) -> tuple[np.ndarray, np.ndarray]:
    """Return first and last time (N,), (N,) at which each Gaussian counts in a picture; infinite where it always
    does."""
    if cloud.begin is not None:
        return cloud.begin, cloud.end
    lifetimes = np.sqrt(2 * np.log(np.maximum(cloud.opacity / LEAST_OPACITY, 1)))
    reach = np.where(cloud.dynamic & np.isfinite(cloud.t_sigma), cloud.t_sigma * lifetimes, np.inf)
    return cloud.t_mu - reach, cloud.t_mu + reach


def _pixel_numbers(across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return which pixel of a picture each of N places falls into, (N,) from 0 on; coordinates in pixels."""
    column, row = np.floor(across).astype(np.int64), np.floor(up).astype(np.int64)
    column -= column.min()
    row -= row.min()
    numbers = column * (row.max() + 1) + row
    # Runaways far from the flame would make the picture huge: then only pixels with something inside are numbered.
    return numbers if numbers.max() < MOST_PIXELS else np.unique(numbers, return_inverse=True)[1]


def display_values(linear: np.ndarray, scene: bpy.types.Scene) -> np.ndarray:
    """Display values (N,) in [0, 1] that the scene's view transform gives linear greys (N,)."""
    ramp = bpy.data.images.new("tone curve", len(linear), 1, float_buffer=True, is_data=False)
    compat.set_linear(ramp)
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
