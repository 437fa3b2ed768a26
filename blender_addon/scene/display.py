"""Light from display values: what a cloud must emit to look in the scene as in its reconstruction.

A reconstruction blends display values: a pixel that the cloud covers by the fraction W with mean colour c shows W c
over the dark. Cycles blends light and applies the view transform f to the sum. Because f is steep in the dark and flat
in the bright, f^-1(colour) of every Gaussian for itself comes out far too bright: thin places, and places whose
Gaussians differ in colour, most of all. So that is only where the light starts. Rounds of correction scale every
Gaussian's light by the mean of wanted, f^-1(W c), over shown light of the pixels that it is in, over all views and
times. The pictures are low in detail and take the Gaussians in any order.

Emissive Gaussians add their light to what is behind them (`gof.core.colour.add_light`), which the opacities they were
fitted with would hide. Drawn with `HIDING` of these they still hide each other, and little of the scene.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.rotations import rotation_matrices
from ..pure.io.cloud import GaussianCloud
from . import compat

STOPS = np.linspace(-14.0, 8.0, 1024)  # linear greys measured, in powers of two
HIDING = 0.5  # part of their opacity with which emissive Gaussians are drawn
DIRECTIONS = 4  # horizontal views that W and c are taken from
MOST_SLICES = 32
LEAST_OPACITY = 1e-3  # of a Gaussian that still counts in a picture
MOST_ROUNDS, ROUNDS_BUDGET = 6, 600_000  # of correction: as many as the budget of Gaussians allows, one at least
POINTS_PER_PIXEL, MOST_POINTS = 4, 64  # that stand for a Gaussian, by the pixels it covers
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
    """Light (N, 3) float64, finite, >= 0, that each Gaussian emits per unit of opacity; emissive ones per unit of
    `HIDING` times it."""
    light = curve.light(cloud.color)
    rounds = max(1, min(MOST_ROUNDS, ROUNDS_BUDGET // max(len(cloud), 1)))
    kept = list(_goals(cloud, curve)) if rounds == MOST_ROUNDS else None  # a larger cloud's take too much memory
    for _ in range(rounds):
        lacking, weight = np.zeros_like(light), np.zeros(len(light))
        for picture, wanted in kept or _goals(cloud, curve):
            ratio, share = picture.compare(wanted, light, HIDING if cloud.emissive else 1.0)
            weight += np.bincount(picture.rows, share, len(light))
            for channel in range(3):
                lacking[:, channel] += np.bincount(picture.rows, share * ratio[picture.owner, channel], len(light))
        # Gaussians that no picture shows keep theirs.
        scale = np.where(weight[:, None] > 0, lacking / np.maximum(weight, 1e-300)[:, None], 1.0)
        light *= np.clip(scale, 0.1, 10)
    return light


def _goals(cloud: GaussianCloud, curve: ToneCurve) -> Iterator[tuple[PixelPoints, np.ndarray]]:
    """Yield each of `pictures` with the light (P, 3) that it is to show."""
    for picture in pictures(cloud):
        yield picture, curve.light(picture.reconstructed(cloud.color))


@dataclass(frozen=True)
class PixelPoints:
    """M points that stand for Gaussians in the P pixels of one view at one time."""

    rows: np.ndarray  # (M,) of which Gaussian
    owner: np.ndarray  # (M,) pixel of each
    depth: np.ndarray  # (M,) optical depth of each, spread over a pixel
    place: np.ndarray  # (M, 3) m
    time_s: float
    area: float  # of a pixel, m^2

    @property
    def total(self) -> np.ndarray:
        """Optical depth of each pixel, (P,) > 0."""
        return np.maximum(np.bincount(self.owner, self.depth), 1e-12)

    def reconstructed(self, color: np.ndarray) -> np.ndarray:
        """Return the display values (P, 3) that a reconstruction with colours (N, 3) shows."""
        total = self.total
        return self._mean(color, total) * -np.expm1(-total)[:, None]

    def compare(self, wanted: np.ndarray, light: np.ndarray, hiding: float) -> tuple[np.ndarray, np.ndarray]:
        """Return wanted over shown light (P, 3), and each point's share (M,) of what its pixel shows.

        Args:
            wanted: (P, 3) light.   light: (N, 3) per unit of opacity.
            hiding: part of the opacity that Cycles draws.
        """
        total = self.total
        covered = -np.expm1(-hiding * total)
        shown = self._mean(light, total) * covered[:, None]
        return wanted / np.maximum(shown, 1e-9), self.depth * (covered / total)[self.owner]

    def intensity(self, light: np.ndarray, hiding: float) -> np.ndarray:
        """Return what each point sends towards the viewer, (M, 3): radiance times area."""
        total = self.total
        share = self.depth * (-np.expm1(-hiding * total) / total)[self.owner]
        return light[self.rows] * (share * self.area)[:, None]

    def _mean(self, values: np.ndarray, total: np.ndarray) -> np.ndarray:
        """Return the mean (P, 3) of values (N, 3) in each pixel."""
        sums = [np.bincount(self.owner, self.depth * values[self.rows, channel]) for channel in range(3)]
        return np.column_stack(sums) / total[:, None]


def pictures(cloud: GaussianCloud) -> Iterator[PixelPoints]:
    """Yield the cloud at times two standard deviations of its lifetimes apart, in horizontal views all around; every
    time the same."""
    random = np.random.default_rng(0)
    axes = rotation_matrices(cloud.rotation) * cloud.scale[:, None, :]
    spread = cloud.scale.astype(np.float64).prod(1) ** (2 / 3)  # product of the two standard deviations seen in a view
    pixel = 2 * float(np.median(np.sqrt(spread)))
    first, last = _seen(cloud)
    slices, length = _slices(cloud, first, last)
    for number in np.unique(slices):
        time = np.float32(number * length)
        alive = np.flatnonzero(((first <= time) & (time <= last)) | (slices == number))
        age = np.where(cloud.dynamic[alive], time - cloud.t_mu[alive], np.float32(0))
        alpha = cloud.opacity[alive] * np.exp(-0.5 * np.minimum(np.abs(age) / cloud.t_sigma[alive], 40) ** 2)
        points = np.clip(np.ceil(POINTS_PER_PIXEL * spread[alive] / pixel**2), 1, MOST_POINTS).astype(int)
        rows = np.repeat(alive, points)
        place = np.repeat(cloud.position[alive] + age[:, None] * cloud.velocity[alive], points, 0)
        place = (place + np.einsum("nij,nj->ni", axes[rows], random.standard_normal((len(rows), 3)))) / pixel
        depth = np.repeat(2 * np.pi * alpha * spread[alive] / pixel**2 / points, points)
        place_m = place * pixel
        for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            across = place[:, 0] * np.cos(angle) + place[:, 1] * np.sin(angle)
            owner = _pixel_numbers(across, place[:, 2])
            yield PixelPoints(rows, owner, depth, place_m, float(time), pixel**2)


def _slices(cloud: GaussianCloud, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the number of the time slice (N,) in whose middle each Gaussian is brightest, and the slices' length."""
    bounded = np.isfinite(first) & np.isfinite(last)
    if not bounded.any():
        return np.zeros(len(cloud)), 1.0
    middle = np.zeros(len(cloud))
    middle[bounded] = (cloud.t_mu if cloud.begin is None else (first + last) / 2)[bounded]
    length = max(2 / 7 * float(np.median((last - first)[bounded])), float(np.ptp(middle[bounded])) / MOST_SLICES, 1e-9)
    return np.round(middle / length), length


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
