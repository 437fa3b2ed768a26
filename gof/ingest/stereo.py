"""Depth of still views with known cameras by rectified semi-global matching and a check between views (OpenCV only)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera
from gof.footage.lens import STRAIGHT

MARGIN = 1.3  # size of a rectified picture against the picture's own: little is cut off
BLOCK = 5  # px, side of the windows that are compared
MAX_RETURN_PX = 1.5  # how far matching there and back may end from where it began
TOLERANCE = 0.02  # relative, of depths that agree


def depth_range(cameras: list[Camera], points: np.ndarray, margin: float = 1.5) -> tuple[float, float]:
    """Return nearest and farthest depth (m) worth searching: the points' 1st and 99th percentile in all views, times
    `margin`.

    Args:
        points: (N, 3) world; with fewer than 8 in front of the cameras, 1/4 to 80 times the longest baseline.
    """
    depth = np.concatenate([c.to_camera(points)[:, 2] for c in cameras]) if len(points) else np.zeros(0)
    depth = depth[depth > 0]
    if len(depth) < 8:
        baseline = max(float(np.linalg.norm(a.position - b.position)) for a in cameras for b in cameras)
        return 0.25 * baseline, 80 * baseline
    return float(np.percentile(depth, 1) / margin), float(np.percentile(depth, 99) * margin)


def semi_global(
    pictures: list[np.ndarray], cameras: list[Camera], reference: int, other: int, near: float, far: float
) -> np.ndarray:
    """Return depth of one view by rectified semi-global matching (Hirschmueller 2008) with another.

    Args:
        pictures: (H, W, 3) uint8 RGB per camera.   near, far: m.
    Returns:
        (H, W) float32 m in the reference view, NaN where there is no match.
    """
    h, w = pictures[reference].shape[:2]
    pair = _Rectified.of(cameras[reference], cameras[other], w, h)
    left = pair.rectify(pictures[reference], pair.first)
    right = pair.rectify(pictures[other], pair.second)
    disparity = _matched_both_ways(left, right, *pair.disparity_range(near, far))
    depth = pair.depth(disparity, w, h)
    return np.where((depth > 0.5 * near) & (depth < 2 * far), depth, np.nan).astype(np.float32)


@dataclass(frozen=True)
class _RectifiedView:
    """One camera of a rectified pair, OpenCV's pixel convention (centres at integers): K (3, 3) of the picture, the
    rotation R (3, 3) into rectified axes, the projection P (3, 4) of the rectified picture."""

    K: np.ndarray
    R: np.ndarray
    P: np.ndarray


@dataclass(frozen=True)
class _Rectified:
    """Two views resampled so that a point lies in the same row of both; size is (width, height) in px."""

    first: _RectifiedView
    second: _RectifiedView
    size: tuple[int, int]

    @classmethod
    def of(cls, first: Camera, second: Camera, width: int, height: int) -> _Rectified:
        import cv2

        relative: np.ndarray = second.world_to_camera @ np.linalg.inv(first.world_to_camera)
        K1, K2 = first.K.copy(), second.K.copy()
        for K in (K1, K2):
            K[:2, 2] -= 0.5
        size = (round(MARGIN * width), round(MARGIN * height))
        R1, R2, P1, P2, *_ = cv2.stereoRectify(
            K1,
            STRAIGHT,
            K2,
            STRAIGHT,
            (width, height),
            relative[:3, :3],
            relative[:3, 3:].copy(),
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=-1,  # keeps the focal length; OpenCV's other choices turn it negative for strongly turned pairs
        )
        to_middle = np.array([[1, 0, (size[0] - width) / 2], [0, 1, (size[1] - height) / 2], [0, 0, 1]])
        return cls(_RectifiedView(K1, R1, to_middle @ P1), _RectifiedView(K2, R2, to_middle @ P2), size)

    def rectify(self, picture: np.ndarray, view: _RectifiedView) -> np.ndarray:
        """Return the view's picture (H, W, 3) RGB in grey, rectified."""
        import cv2

        x, y = cv2.initUndistortRectifyMap(view.K, STRAIGHT, view.R, view.P, self.size, cv2.CV_32FC1)
        return np.asarray(cv2.remap(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), x, y, cv2.INTER_LINEAR))

    def disparity_range(self, near: float, far: float) -> tuple[int, int]:
        """Lowest disparity and their number, a multiple of 16, for depths between near and far (m)."""
        # disparity = P[0, 3] / z of the second view, with its sign: negative for a camera to the right.
        offset = self.first.P[0, 2] - self.second.P[0, 2]
        low, high = sorted(offset - self.second.P[0, 3] / z for z in (near, far))
        low = int(np.floor(low))
        return low, int(np.ceil((high - low) / 16) * 16) or 16

    def depth(self, disparity: np.ndarray, width: int, height: int) -> np.ndarray:
        """Return (H, W) m along the first camera's own axis, at its own pixels, of rectified disparity; NaN where
        unknown."""
        import cv2

        K, R, P = self.first.K, self.first.R, self.first.P
        z = -self.second.P[0, 3] / np.where(np.abs(disparity) > 1e-6, disparity, np.nan)
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1) @ R.T
        u = rays[..., 0] / rays[..., 2] * P[0, 0] + P[0, 2]
        v = rays[..., 1] / rays[..., 2] * P[1, 1] + P[1, 2]
        z = cv2.remap(
            z.astype(np.float32),
            u.astype(np.float32),
            v.astype(np.float32),
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(float("nan"),),
        )
        return z / rays[..., 2]


def _matched_both_ways(left: np.ndarray, right: np.ndarray, low: int, count: int) -> np.ndarray:
    """Disparity (H, W) float32 of the left picture, NaN where matching from the right one does not come back."""
    # Padded by the largest disparity: OpenCV searches nothing in the first columns otherwise.
    pad = max(abs(low), abs(low + count)) + 8
    forward = _matched(left, right, low, count, pad)
    back = _matched(right, left, -(low + count - 1), count, pad)
    last = left.shape[1] - 1
    columns = np.arange(last + 1) - np.nan_to_num(forward, nan=1e6)
    inside = (columns >= 0) & (columns <= last)
    returned = np.take_along_axis(back, np.clip(np.rint(columns), 0, last).astype(int), 1)
    return np.where(inside & (np.abs(forward + returned) < MAX_RETURN_PX), forward, np.float32(np.nan))


def _matched(first: np.ndarray, second: np.ndarray, low: int, count: int, pad: int) -> np.ndarray:
    """Disparity (H, W) float32 px by OpenCV's matcher, from `low` to `low + count`; NaN where there is no match."""
    import cv2

    first, second = (cv2.copyMakeBorder(p, 0, 0, pad, pad, cv2.BORDER_REPLICATE) for p in (first, second))
    matcher = cv2.StereoSGBM.create(
        low,
        count,
        BLOCK,
        8 * BLOCK**2,
        32 * BLOCK**2,
        uniquenessRatio=8,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    found = matcher.compute(first, second).astype(np.float32)[:, pad:-pad] / 16
    return np.where(found < low, np.float32(np.nan), found)


def stereo_depth(pictures: list[np.ndarray], cameras: list[Camera], points: np.ndarray) -> list[np.ndarray]:
    """`neighbours_matched`, kept where another view's depth confirms it.

    Args:
        pictures: (H, W, 3) uint8 per camera.   points: (N, 3) sparse world points, for the depth range.
    Returns:
        (H, W) float32 m per camera, NaN where unknown.
    """
    return consistent(neighbours_matched(pictures, cameras, *depth_range(cameras, points)), cameras)


def neighbours_matched(pictures: list[np.ndarray], cameras: list[Camera], near: float, far: float) -> list[np.ndarray]:
    """Return every view matched with the cameras next to it: (H, W) float32 m, median of the answers, NaN without
    one."""
    depths = []
    for reference in range(len(cameras)):
        away = [np.linalg.norm(c.position - cameras[reference].position) for c in cameras]
        nearest = min(d for o, d in enumerate(away) if o != reference)
        # Wider pairs mismatch more than they add.
        others = [o for o, d in enumerate(away) if o != reference and d < 1.5 * nearest]
        answers = np.stack([semi_global(pictures, cameras, reference, o, near, far) for o in others])
        known = np.isfinite(answers).any(0)
        answers[:, ~known] = 0
        depths.append(np.where(known, np.nanmedian(answers, axis=0), np.nan).astype(np.float32))
    return depths


def consistent(depths: list[np.ndarray], cameras: list[Camera]) -> list[np.ndarray]:
    """Return depth maps (H, W) without what no other map confirms within a relative TOLERANCE; NaN there."""
    kept = []
    for c, depth in enumerate(depths):
        h, w = depth.shape
        x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
        points = cameras[c].unproject(np.column_stack([x.ravel(), y.ravel()]), depth.ravel())
        agree = np.zeros(depth.size, bool)
        for o, other in enumerate(cameras):
            if o != c:
                pixels, z = other.project(points)
                with np.errstate(invalid="ignore"):
                    agree |= np.abs(_looked_up(depths[o], pixels) - z) < TOLERANCE * z
        kept.append(np.where(agree.reshape(h, w), depth, np.nan).astype(np.float32))
    return kept


def _looked_up(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return (N,) values of a map (H, W) at pixels (N, 2), the nearest one; NaN outside, and for pixels that are
    NaN."""
    column, row = np.floor(np.nan_to_num(pixels, nan=-1)).astype(int).T
    inside = (column >= 0) & (column < depth.shape[1]) & (row >= 0) & (row < depth.shape[0])
    return np.where(inside, depth[np.where(inside, row, 0), np.where(inside, column, 0)], np.nan)
