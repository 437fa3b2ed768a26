"""Views from where no camera stood: what tomography says of them, which holds the optimisation there.

Pictures from one side leave open how far their light reaches along the rays, and what one Gaussian does wrong another
one behind it repairs, for these cameras only. Tomography is coarse, but the same flame from everywhere. So what it says
is drawn from all around, in pixels as large as voxels, and Gaussians may not be something else there.

How light of a clip looks is taken from its own pictures: thickness of flame against linear light, channel by channel.
Pictures of one thickness differ, the more the worse tomography explains the clip. Within that spread, Gaussians are
free: a filmed flame, of which it knows less, is held less.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import diags

from gof.core.cameras import Camera
from gof.core.colour import srgb_to_linear
from gof.host.threads import map_on_cores
from gof.reconstruct.observation import Observation
from gof.reconstruct.tomography import TURNS, find_emission
from gof.reconstruct.voxels import FlameVoxels, carve, share_among_pixels
from gof.render.bins import BLOCK

VIEWS = 12  # around the flame, one every 30 degrees; and one from above
SATURATED, OFTEN = 0.95, 0.25  # linear light; of a flame's pixels, from which share on a channel tells too little
THICKEST = 2e-3  # of the light that passes through: what is thicker is not told apart
FAR, BEHIND = 4.0, 3.5  # std-devs of the light around its axis; and along the cameras' common direction
ANOTHER = 0.02  # of all light, from which on what is so far is another flame
UNLIKE = 1.5  # times the usual light, from which on a camera's exposure is another
LEVELS = 48  # of the curve of light by thickness
THIN, SURE = 0.1, 0.5  # of the usual thickness: below the first it tells nothing of its light, up to the second it does


class UnseenView(NamedTuple):
    """The view of a camera in K frames.

    Attributes:
        time_s: (K,) on the dataset clock.   thickness: (K * h * w,) float32.   levels, curves: see `UnseenViews`.
    """

    camera: Camera
    time_s: np.ndarray
    thickness: np.ndarray
    levels: np.ndarray
    curves: np.ndarray

    @property
    def light(self) -> np.ndarray:
        """(3, K * h * w) float32 linear light over black."""
        return self._looked_up(self.curves[:, :3])

    @property
    def spread(self) -> np.ndarray:
        """(3, K * h * w) float32: how far the light may be off."""
        return self._looked_up(self.curves[:, 3:])

    def _looked_up(self, curves: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(self.thickness, self.levels, curve) for curve in curves.T]).astype(np.float32)


@dataclass(frozen=True)
class UnseenViews:
    """How the flame looks from V cameras that are not there, in F frames.

    Attributes:
        cameras: V of one size, with pixels as large as voxels.
        frames: (F,) which of the observation's frames, ascending; only those that every camera took.
        time_s: (F,) of these, on the dataset clock.
        thickness: (F, V, h, w) float16 >= 0, of flame along each pixel's ray, in a unit of the clip's own.
        levels: (L,) ascending thicknesses.   curves: (L, 6) linear light of each, three channels, and the median
            difference of the clip's own pictures from it.
    """

    cameras: list[Camera]
    frames: np.ndarray
    time_s: np.ndarray
    thickness: np.ndarray
    levels: np.ndarray
    curves: np.ndarray

    def view(self, rows: Sequence[int], camera: int) -> UnseenView:
        """Return the view of these rows of `frames` from a row of `cameras`."""
        thickness = self.thickness[list(rows), camera].astype(np.float32).ravel()
        return UnseenView(self.cameras[camera], self.time_s[list(rows)], thickness, self.levels, self.curves)

    def choose(self, frames: Sequence[int], rng: np.random.Generator) -> UnseenView | None:
        """Return a view of frames of the observation, from a camera by chance; None where one has none."""
        rows = np.flatnonzero(np.isin(self.frames, frames)).tolist()
        return self.view(rows, int(rng.integers(len(self.cameras)))) if len(rows) == len(frames) else None


@dataclass(frozen=True)
class FlameEmission:
    """The place of a clip's light in space, in F frames.

    Attributes:
        voxels: V, on a grid of their own.
        emission: (F, V) float32 >= 0; 0 in frames that a camera did not take.
    """

    voxels: FlameVoxels
    emission: np.ndarray

    def pool(self, coarser: FlameVoxels) -> np.ndarray:
        """Return (F, W) the light within each of W coarser voxels of the same world; light outside them is left out.

        Each voxel gives the part of it that is within. Were it counted where its middle is, every other coarser voxel
        would have twice the light.
        """
        fine, size = self.voxels, self.voxels.voxel_size / coarser.voxel_size
        away = coarser.first_center - fine.first_center
        shares = []
        for axis in range(3):
            low = (np.arange(fine.resolution[axis]) - 0.5) * size + 0.5 - away[axis] / coarser.voxel_size
            start = np.arange(coarser.resolution[axis])[:, None]
            overlap = np.minimum(low + size, start + 1) - np.maximum(low, start)
            shares.append((np.maximum(overlap, 0) / size).astype(np.float32))

        def pooled(light: np.ndarray) -> np.ndarray:
            dense = np.zeros(fine.resolution, np.float32)
            dense[tuple(fine.index.T)] = light
            return np.einsum("ax,by,cz,xyz->abc", *shares, dense, optimize=True)[tuple(coarser.index.T)]

        return np.stack(map_on_cores(pooled, self.emission))


def find_flame_emission(
    observation: Observation, longest_side: int, progress: Callable[..., None] | None = None
) -> FlameEmission:
    """Return a clip's light by `find_emission`, turned, of what its pictures show unsaturated.

    Args:
        longest_side: voxels along the longest side of the flame, see `carve`, which says what is raised, too.
        progress: called with (done, total) after every frame.
    """
    voxels = carve(observation.cameras, observation.mask, longest_side, blocked=observation.blocked)
    light = unsaturated_light(observation)
    light *= find_gains(voxels, light, observation.mask).astype(np.float32)[:, None, None]
    taken = observation.delivered.all(1)
    nothing = np.zeros(len(voxels.center), np.float32)

    def find(f: int) -> np.ndarray:
        found = find_emission(voxels, light[f], observation.mask[f], turns=TURNS) if taken[f] else nothing
        return found.astype(np.float32)

    emission = np.stack(map_on_cores(find, range(len(light)), progress))
    return FlameEmission(voxels, np.where(_is_near(voxels, emission.sum(0, dtype=np.float64)), emission, 0))


def find_gains(voxels: FlameVoxels, light: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return (C,) factors that make cameras with another exposure as bright as the others; 1 where they differ little.

    All see one flame: summed over the voxels that all have in view, the light before or behind them is about the same.

    Args:
        light: (F, C, H, W) >= 0, which adds up along rays.   mask: (F, C, H, W) bool.
    """
    shown = np.einsum("fchw,fchw->chw", light, mask, dtype=np.float64)
    seen = voxels.sample(shown, outside=np.nan)
    total = seen[:, np.isfinite(seen).all(0)].sum(1)
    usual = np.median(total[total > 0]) if (total > 0).any() else 1.0
    gain = usual / np.where(total > 0, total, usual)
    return np.where((gain > UNLIKE) | (gain < 1 / UNLIKE), gain, 1.0)


def _is_near(voxels: FlameVoxels, light: np.ndarray) -> np.ndarray:
    """(V,) bool: where a clip's light (V,) >= 0 is its flame. Masks' specks and surroundings in the fire's light,
    which shine far beside it, are none: they would be streaks in the air from other sides. Nor is lit ground, which
    cameras on one side find far before or behind it. More light is a flame."""
    if not light.any():
        return np.ones(len(light), bool)
    away = voxels.center[:, :2] - np.average(voxels.center[:, :2], axis=0, weights=light)
    ahead = voxels.common_ray
    distances2 = [(FAR, (away**2).sum(1))]
    if ahead is not None:
        distances2.append((BEHIND, (away @ ahead[:2]) ** 2))
    near = np.all([away2 <= most**2 * np.average(away2, weights=light) for most, away2 in distances2], axis=0)
    return near if light[~near].sum() < ANOTHER * light.sum() else np.ones(len(light), bool)


def imagine_views(
    light: FlameEmission, observation: Observation, cameras: list[Camera] | None = None
) -> UnseenViews | None:
    """Return how a clip's light looks from all around; None where it is dark.

    cameras: of one size, with pixels of about a voxel; by default those of `cameras_around`.
    """
    voxels, frames = light.voxels, np.flatnonzero(light.emission.any(1))
    if not len(frames):
        return None
    shining = light.emission[frames].T
    levels, usual, spread = _light_by_thickness(voxels, shining, observation, frames)
    cameras = cameras or cameras_around(voxels, observation.cameras)
    thickness = np.stack(map_on_cores(lambda camera: _thickness(voxels, shining, camera), cameras), 1)
    curves = np.concatenate([usual, spread], 1)
    return UnseenViews(cameras, frames, observation.time_s[frames], thickness.astype(np.float16), levels, curves)


def unsaturated_light(observation: Observation) -> np.ndarray:
    """Return (F, C, H, W) float32 >= 0: the thickness of flame, up to a factor, in the brightest channel that tells it.

    Light l of [0, 1] that every part of a flame adds to what is left of 1 is unrolled by -log(1 - l), which adds up
    along a ray. A screen shows no more than white, but the brightest channel draws a clip's own pictures best even
    where a sixth of it is white; only what is white in more than a quarter gives way to the next.
    """
    plate = srgb_to_linear(observation.plate)
    flame = observation.mask & observation.delivered[..., None, None]
    count, often, bright = int(flame.sum()), np.zeros(3), np.zeros(3)
    for picture, inside in zip(observation.image, flame, strict=True):  # a whole clip's linear light takes gigabytes
        light = srgb_to_linear(picture[inside])
        often += (light > SATURATED).sum(0) / max(count, 1)
        bright += np.maximum(light - plate[inside], 0).sum(0, dtype=np.float64) / max(count, 1)
    unsaturated = often <= max(OFTEN, often.min())
    channel = int(np.argmax(np.where(unsaturated, bright, -1)))
    clear = np.log(np.maximum(1 - plate[..., channel], THICKEST))
    thickness = np.empty(observation.image.shape[:-1], np.float32)
    for f, picture in enumerate(observation.image):
        through = np.maximum(1 - srgb_to_linear(picture[..., channel]), THICKEST)
        thickness[f] = np.maximum(clear - np.log(through), 0)
    return thickness


def cameras_around(voxels: FlameVoxels, cameras: list[Camera], views: int = VIEWS) -> list[Camera]:
    """Return cameras as far from the flame as the given ones, `views` at even angles and as high above it (+z is up),
    and one that looks straight down.

    None stands nearer than the flame is long: it would have a part of it beside or behind itself. Pixels are as large
    as voxels in the middle of the flame, and pictures no larger than it needs.
    """
    low, high = voxels.center.min(0), voxels.center.max(0)
    middle = (low + high) / 2
    away = np.stack([camera.position for camera in cameras]) - middle
    distance = max(np.linalg.norm(away, axis=1).mean(), np.linalg.norm(high - low), voxels.voxel_size)
    climb = np.arctan2(away[:, 2], np.linalg.norm(away[:, :2], axis=1)).mean()
    first = np.arctan2(*away[len(cameras) // 2, 1::-1]) + np.pi / views
    around = []
    ring = [(angle, climb) for angle in first + 2 * np.pi * np.arange(views) / views]
    for k, (angle, climb) in enumerate([*ring, (first, np.pi / 2)]):
        out = np.array([np.cos(climb) * np.cos(angle), np.cos(climb) * np.sin(angle), np.sin(climb)])
        right = np.array([-np.sin(angle), np.cos(angle), 0])
        turn = np.stack([right, np.cross(-out, right), -out])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, -turn @ (middle + distance * out)
        K = np.diag([distance / voxels.voxel_size, distance / voxels.voxel_size, 1.0])
        around.append(Camera(f"unseen_{k}", 1, 1, K, pose))
    reaches = map_on_cores(lambda camera: np.abs(camera.project(voxels.center)[0]).max(0), around)
    reach = np.nanmax(reaches, axis=0)
    width, height = (-(-(2 * reach + 4) // BLOCK) * BLOCK).astype(int).tolist()
    centred = np.array([[0, 0, width / 2], [0, 0, height / 2], [0, 0, 0]])
    return [replace(camera, width=width, height=height, K=camera.K + centred) for camera in around]


def _thickness(voxels: FlameVoxels, emission: np.ndarray, camera: Camera) -> np.ndarray:
    """(F, h, w) float32 of emission (V, F) along the rays of a camera with pixels of about a voxel."""
    place, depth = camera.project(voxels.center)
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.where(depth > 0, (voxels.voxel_size * camera.K[0, 0] / depth) ** 2, 0)  # that a voxel's face fills
    share = share_among_pixels(place, camera.width, camera.height) @ diags(pixels)
    return (share.astype(np.float32) @ emission).T.reshape(-1, camera.height, camera.width)


def _light_by_thickness(
    voxels: FlameVoxels, emission: np.ndarray, observation: Observation, frames: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Levels (L,) of thickness; the mean linear light (L, 3) of each in the clip's own pictures, both rising; and the
    median difference (L, 3) of these pictures from it."""
    thick, bright = [np.zeros(0)], [np.zeros((0, 3))]
    for c, camera in enumerate(observation.cameras):
        pixels_per_voxel = voxels.voxel_size * float(np.nanmedian(np.abs(voxels.jacobian[c]).max((-1, -2))))
        size = [max(round(n / pixels_per_voxel), 1) for n in (camera.width, camera.height)]
        small = camera.scaled(*size)
        thickness = _thickness(voxels, emission, small)
        plate = srgb_to_linear(observation.plate[c])
        for f, seen in zip(frames, thickness, strict=True):
            light = cv2.resize(srgb_to_linear(observation.image[f, c]) - plate, size, interpolation=cv2.INTER_AREA)
            flame = cv2.resize(observation.mask[f, c].astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
            thick.append(seen[flame])
            bright.append(light[flame])
    thickness, light = np.concatenate(thick), np.concatenate(bright)
    if not len(thickness):
        return np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 3))
    edges = np.unique(np.quantile(thickness, np.linspace(0, 1, LEVELS + 1)))
    level = np.clip(np.searchsorted(edges, thickness, "right") - 1, 0, max(len(edges) - 2, 0))
    used = np.unique(level)
    levels = np.array([np.median(thickness[level == k]) for k in used])
    curve = np.array([light[level == k].mean(axis=0) for k in used])
    levels, curve = np.maximum(levels, 1e-12), np.maximum.accumulate(np.maximum(curve, 0))
    # Masks reach beyond the flame, where pictures differ from their plates and tomography finds hardly any. All of the
    # hull would glow in unseen views, so thin flame gives no more than a straight line of light per thickness says.
    usual = np.average(thickness, weights=thickness) if thickness.any() else 0.0
    thin = levels < THIN * usual
    sure = ~thin & (levels < SURE * usual)
    if sure.sum() > 1:
        fall, start = np.polyfit(levels[sure], curve[sure] / levels[sure, None], 1)
        little = levels[thin, None]
        curve[thin] = np.minimum(curve[thin], np.maximum(start + np.minimum(fall, 0) * little, 0) * little)
    spread = np.array([np.median(abs(light[level == k] - mean), axis=0) for k, mean in zip(used, curve, strict=True)])
    nothing = np.zeros((1, 3))
    return np.append(0.0, levels), np.concatenate([nothing, curve]), np.concatenate([nothing, spread])
