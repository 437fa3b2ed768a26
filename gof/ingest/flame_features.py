"""Features on the flame itself, matched between cameras that film it at one moment.

From a few degrees to the side a flame's wrinkles look alike, and half of their matches are right to a third of a pixel.
Cameras take their frames a millisecond apart, and a rolling shutter its lines: in that time a flame moves a pixel. So
each feature is moved to the frame's common moment, by its own motion to the next frame.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gof.core.cameras import Camera
from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import Lens
from gof.ingest.sfm import Features

MOST_FRAMES = 40  # more add little: neighbouring frames show the same wrinkles
LONGEST_SIDE = 960  # px; larger pictures are shrunk to it
RATIO = 0.8  # of the distances to the nearest and the second feature (Lowe 2004)
CONTRAST = 0.02
MARGIN_PX = 16  # around the flame, for the features at its edge
WINDOW_PX = 15  # in which a feature is followed to the next frame
MOST_APART_PX = 0.5  # of a feature that was followed there and back again


@dataclass(frozen=True)
class FlameFeatures:
    """Matches of several moments, pooled as if each camera had seen all in one picture.

    Attributes:
        features: keypoints and matches, px of the shrunk pictures.
        lenses: of these.
        frame: (N,) per camera: number of the moment of each keypoint.
        middles: (C, 2) px of the middle of each camera's flame light; NaN where there is none.
    """

    features: Features
    lenses: list[Lens]
    frame: list[np.ndarray]
    middles: np.ndarray

    def of_moments(self, parity: int) -> Features:
        """Return the matches of every second moment: the even ones or the odd ones."""
        kept = {(i, j): m[self.frame[i][m[:, 0]] % 2 == parity] for (i, j), m in self.features.matches.items()}
        return Features(self.features.keypoints, kept)


@dataclass(frozen=True)
class Moments:
    """The moments whose features are matched.

    Attributes:
        places: numbers of the clip's frames, each with the next one of the video after it.
        time_s: (T,) per camera: when each of the clip's frames begins.
        common_s: (T,) the moment to which its features are moved: the mean of when the cameras read their middle line.
    """

    places: np.ndarray
    time_s: list[np.ndarray]
    common_s: np.ndarray

    @classmethod
    def of(cls, numbers: np.ndarray, time_s: list[np.ndarray], cameras: list[Camera]) -> Moments:
        """Choose from frames of these numbers (T,) in the dataset, increasing; held-out ones lack."""
        pairs = np.flatnonzero(np.diff(numbers) == 1)
        chosen = pairs[np.unique(np.linspace(0, len(pairs) - 1, min(MOST_FRAMES, len(pairs))).round().astype(int))]
        middle_s = [t + _lines(c) / 2 * c.row_time_s for t, c in zip(time_s, cameras, strict=True)]
        return cls(chosen, time_s, np.mean(middle_s, 0))


def _lines(camera: Camera) -> int:
    """Return how many lines a camera reads one after another."""
    return camera.height if camera.readout in ("up", "down") else camera.width


def match_flames(
    clips: Sequence[Collection[np.ndarray]], plates: list[np.ndarray], cameras: list[Camera], moments: Moments
) -> FlameFeatures:
    """Return features on the flame, and their matches between all pairs of cameras.

    Args:
        clips: (H, W, 3) uint8 RGB per camera.   plates: the same without fire.
        cameras: of these pictures, which are shrunk to LONGEST_SIDE; their poses are not used.
    """
    small = [_shrunk(camera) for camera in cameras]
    seen = [_SeenFlame.of(*view, moments, c) for c, view in enumerate(zip(clips, plates, small, strict=True))]
    first = [np.concatenate([[0], np.cumsum([len(p) for p in s.pixels])]).astype(int) for s in seen]
    matches = {}
    for i, j in combinations(range(len(seen)), 2):
        each = [
            _matched(a, b) + [first[i][k], first[j][k]]
            for k, (a, b) in enumerate(zip(seen[i].kinds, seen[j].kinds, strict=True))
        ]
        matches[i, j] = np.concatenate([*each, np.zeros((0, 2), int)]).astype(np.int64)
    keypoints = [np.concatenate([*s.pixels, np.zeros((0, 2))]) for s in seen]
    frame = [np.repeat(np.arange(len(s.pixels)), [len(p) for p in s.pixels]) for s in seen]
    lenses = [Lens(camera.width, camera.height, camera.K) for camera in small]
    return FlameFeatures(Features(keypoints, matches), lenses, frame, np.array([s.middle for s in seen]))


def _shrunk(camera: Camera) -> Camera:
    """Return the camera of pictures whose longer side is at most LONGEST_SIDE."""
    share = min(1.0, LONGEST_SIDE / max(camera.width, camera.height))
    return camera.scaled(max(1, round(share * camera.width)), max(1, round(share * camera.height)))


@dataclass(frozen=True)
class _SeenFlame:
    """One camera's features in shrunk pictures.

    Attributes:
        pixels, kinds: (N, 2) px and descriptors (N, 128) of every moment.   middle: (2,) px of its light.
    """

    pixels: list[np.ndarray]
    kinds: list[np.ndarray]
    middle: np.ndarray

    @classmethod
    def of(
        cls, clip: Collection[np.ndarray], plate: np.ndarray, camera: Camera, moments: Moments, number: int
    ) -> _SeenFlame:
        import cv2

        size = (camera.width, camera.height)
        fire_free = cv2.resize(plate, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        wanted, shown = {*moments.places.tolist(), *(moments.places + 1).tolist()}, {}
        pixels, kinds, sums = [], [], np.zeros(3)
        for k, picture in enumerate(clip):
            if k not in wanted:
                continue
            shown[k] = _flame_alone(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), fire_free)
            if k - 1 in moments.places:
                (light, mask), (later, _) = shown[k - 1], shown[k]
                found, kind = _features(light, mask)
                moved, held = _at_one_moment(found, light, later, camera, moments, number, k - 1)
                pixels.append(moved[held])
                kinds.append(kind[held])
                sums += _light_sums(light)
            shown.pop(k - 1, None)
        middle = sums[:2] / sums[2] if sums[2] > 0 else np.full(2, np.nan)
        return cls(pixels, kinds, middle)


def _flame_alone(picture: np.ndarray, fire_free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) uint8 green display values of the flame's own light, and its mask (H, W) bool. Green is clipped in
    far fewer pixels than red."""
    image = picture.astype(np.float32) / 255
    mask = flame_mask(image, fire_free)
    light = np.maximum(srgb_to_linear(image[..., 1]) - srgb_to_linear(fire_free[..., 1]), 0) * mask
    return np.rint(255 * linear_to_srgb(light)).astype(np.uint8), mask


def _light_sums(light: np.ndarray) -> np.ndarray:
    """Return (3,): the sums of x, y (px) and 1, weighted by linear light."""
    linear = srgb_to_linear(np.arange(256) / 255)[light].astype(np.float64)
    columns, rows = linear.sum(0), linear.sum(1)
    x, y = np.arange(len(columns)) + 0.5, np.arange(len(rows)) + 0.5
    return np.array([x @ columns, y @ rows, columns.sum()])


def _features(light: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) px, float64, pixel centres at integer + 0.5, and descriptors (N, 128) where the mask holds."""
    import cv2

    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    top, left = max(rows[0] - MARGIN_PX, 0), max(columns[0] - MARGIN_PX, 0)
    part = slice(top, rows[-1] + 1 + MARGIN_PX), slice(left, columns[-1] + 1 + MARGIN_PX)
    where = np.ascontiguousarray(mask[part]).astype(np.uint8)
    points, kinds = cv2.SIFT.create(contrastThreshold=CONTRAST).detectAndCompute(
        np.ascontiguousarray(light[part]), where
    )
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    return np.array([p.pt for p in points]) + [left + 0.5, top + 0.5], kinds


def _at_one_moment(
    pixels: np.ndarray, light: np.ndarray, later: np.ndarray, camera: Camera, moments: Moments, number: int, place: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return where features (N, 2) px are at the common moment, and which could be followed."""
    import cv2

    if not len(pixels):
        return pixels, np.zeros(0, bool)
    times = moments.time_s[number]
    start = (pixels - 0.5).astype(np.float32)[:, None]
    window = (WINDOW_PX, WINDOW_PX)
    shown, onward, _ = cv2.calcOpticalFlowPyrLK(light, later, start, np.empty_like(start), winSize=window, maxLevel=3)
    returned, again, _ = cv2.calcOpticalFlowPyrLK(later, light, shown, np.empty_like(start), winSize=window, maxLevel=3)
    apart = np.linalg.norm((np.asarray(returned) - start).reshape(-1, 2), axis=1)
    held = (onward[:, 0] > 0) & (again[:, 0] > 0) & (apart < MOST_APART_PX)
    line = pixels[:, int(camera.readout in ("up", "down"))]
    line = _lines(camera) - line if camera.readout in ("up", "left") else line
    late_s = times[place] + line * camera.row_time_s - moments.common_s[place]
    step_s = times[place + 1] - times[place]  # positive: frame times increase
    motion = (np.asarray(shown) - start).reshape(-1, 2)
    return pixels - motion * (late_s / step_s)[:, None], held


def _matched(these: np.ndarray, those: np.ndarray) -> np.ndarray:
    """Return (M, 2) pairs of numbers of descriptors (N, 128), the nearest ones that have no near rival."""
    import cv2

    if len(these) < 2 or len(those) < 2:
        return np.zeros((0, 2), int)
    nearest = cv2.BFMatcher().knnMatch(these, those, k=2)
    return np.array([(a.queryIdx, a.trainIdx) for a, b in nearest if a.distance < RATIO * b.distance], int).reshape(
        -1, 2
    )
