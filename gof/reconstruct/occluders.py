"""Still things between a camera and the flame, found by the other cameras: a gap in this one's flame that they fill.

A camera that never sees flame in a place says that no flame is there, and its word ends the hull (`voxels.carve`).
Behind a post it says so wrongly. The flame that all other cameras agree on, rounded (`tomography`), shines through
where the post stands; the camera itself sees flame on both sides of it and never in it. Two flames side by side look
like that too, but to the other cameras as well: where one of them sees flame, a gap and flame, the answer is left open.
"""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof.host.threads import map_on_cores
from gof.reconstruct.tomography import tomography
from gof.reconstruct.voxels import carve

SIDE = 40  # voxels along the flame: occluders thinner than about two of them are not looked for
FRAMES = 12  # of the clip that are looked at, evenly spread
EXPECTED = 0.5  # of the flame's usual light: where the others say less, it may be the hull's slack
MISSING = 0.1  # of what the others say: where a camera sees less, its view is blocked
SOLID = 0.85  # of a row between its first and last flame
LEAST = 2.0  # voxels, square root of the area of what is blocked
EDGE = 1.5  # voxels: so far around, the lights of flame and gap are blurred together
PASSES = 2  # the second pass leaves out cameras that are blocked


def blocked_views(cameras: list[Camera], masks: np.ndarray, intensity: np.ndarray) -> np.ndarray:
    """(C, H, W) bool: where a camera's view of the flame is blocked by something still.

    Only gaps within the flame are found, not what hides one of its ends; and nothing with fewer than three cameras,
    because two must agree on the flame without the one in question.

    Args:
        cameras: C.   masks: (F, C, H, W) bool, where flame may be.   intensity: (F, C, H, W) linear light >= 0.
    """
    frames = np.unique(np.linspace(0, len(masks) - 1, FRAMES).round().astype(int))
    light, blocked = intensity[frames], np.zeros(masks.shape[1:], bool)
    for _ in range(PASSES if len(cameras) > 2 else 0):
        find = partial(_blocked, cameras=cameras, masks=masks, light=light, mask=masks[frames], blocked=blocked)
        blocked = np.stack(map_on_cores(find, range(len(cameras))))
        if not blocked.any():
            break
    return blocked


def _blocked(
    c: int, cameras: list[Camera], masks: np.ndarray, light: np.ndarray, mask: np.ndarray, blocked: np.ndarray
) -> np.ndarray:
    """(H, W) bool of camera c, by what the others see past what blocks them; light, mask: of the frames looked at."""
    gap = _gap(masks[:, c].any(0))
    others = [o for o in range(len(cameras)) if o != c]
    if not gap.any():
        return gap
    try:
        voxels = carve([cameras[o] for o in others], masks[:, others], SIDE, blocked=blocked[others])
    except DataFormatError:  # the others see no flame together: they have nothing to say
        return np.zeros_like(gap)
    solid = voxels.sample(np.stack([_solid(masks[:, o].any(0) | blocked[o]) for o in others])).all(0)
    pixel, _ = cameras[c].project(voxels.center)
    expected = np.zeros(gap.shape)
    for of_frame, mask_of_frame in zip(light[:, others], mask[:, others], strict=True):
        emission = tomography(voxels, of_frame, mask_of_frame)
        emission *= of_frame.sum() / max(emission.sum(), 1.0)
        expected += _seen_from(pixel, solid * emission, gap.shape)
    jacobian = cameras[c].projection_jacobian(voxels.center.mean(0, keepdims=True))
    side = max(1.0, float(np.abs(jacobian).max()) * voxels.voxel_size)
    if not np.isfinite(expected.sum() + side):  # the flame of the others is behind this camera
        return np.zeros_like(gap)
    return _missing(expected, light[:, c].sum(0), gap, side)


def _solid(ever: np.ndarray) -> np.ndarray:
    """(H, W) bool: rows in which the flame ever has hardly a gap (`SOLID`)."""
    between = _between(ever, axis=1)
    share = ever.sum(1) / np.maximum(between.sum(1), 1)
    return np.broadcast_to((share > SOLID)[:, None], ever.shape)


def _gap(ever: np.ndarray) -> np.ndarray:
    """(H, W) bool: where no flame ever is, with flame on two opposite sides of the picture's axes."""
    return ~ever & (_between(ever, 0) | _between(ever, 1))


def _between(ever: np.ndarray, axis: int) -> np.ndarray:
    """(H, W) bool: from the first flame to the last along an axis of the picture."""
    before = np.logical_or.accumulate(ever, axis)
    return before & np.flip(np.logical_or.accumulate(np.flip(ever, axis), axis), axis)


def _seen_from(pixel: np.ndarray, emission: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W): voxels' light summed into the pixels (V, 2) that they fall into."""
    with np.errstate(invalid="ignore"):
        inside = ((pixel >= 0) & (pixel < shape[::-1])).all(-1)
    column, row = pixel[inside].astype(int).T
    return np.bincount(row * shape[1] + column, emission[inside], shape[0] * shape[1]).reshape(shape)


def _missing(expected: np.ndarray, seen: np.ndarray, gap: np.ndarray, side: float) -> np.ndarray:
    """(H, W) bool: gaps, as large as a voxel or more, where the others' light is not seen. side: px of a voxel."""
    expected, seen = (cv2.GaussianBlur(x.astype(np.float64), (0, 0), 0.5 * side) for x in (expected, seen))
    lit = ~gap & (expected > 0) & (seen > 0)
    if not lit.any():
        return np.zeros_like(gap)
    usual = (expected[lit] ** 2).sum() / expected[lit].sum()  # of the light, not of the picture
    scale = seen[lit].sum() / expected[lit].sum()
    missing = gap & (expected > EXPECTED * usual) & (seen < MISSING * scale * expected)
    _, label, stats, _ = cv2.connectedComponentsWithStats(missing.astype(np.uint8))
    large = stats[:, cv2.CC_STAT_AREA] >= (LEAST * side) ** 2
    large[0] = False
    around = cv2.dilate(large[label].astype(np.uint8), np.ones((2 * round(EDGE * side) + 1,) * 2, np.uint8))
    return gap & (around > 0)
