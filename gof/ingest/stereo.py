"""Depth of still views with known cameras by rectified semi-global matching and a check between views (OpenCV only)."""

from __future__ import annotations

import numpy as np

from gof.cameras import Camera

ROOM = 1.3  # size of a rectified picture against the picture's own


def depth_range(cameras: list[Camera], points: np.ndarray, margin: float = 1.5) -> tuple[float, float]:
    """Nearest and farthest depth (m) worth searching: the points' 1st and 99th percentile in all views, times `margin`.

    Args:
        points: (N, 3) world; fewer than 8 in view leave 1/4 to 8 baselines' tenfold.
    """
    depth = np.concatenate([c.to_camera(points)[:, 2] for c in cameras]) if len(points) else np.zeros(0)
    depth = depth[depth > 0]
    if len(depth) < 8:
        baseline = max(np.linalg.norm(a.position - b.position) for a in cameras for b in cameras)
        return 0.25 * baseline, 80 * baseline
    return float(np.percentile(depth, 1) / margin), float(np.percentile(depth, 99) * margin)


def semi_global(
    pictures: list[np.ndarray], cameras: list[Camera], reference: int, other: int, near: float, far: float
) -> np.ndarray:
    """Depth of one view by rectified semi-global matching (Hirschmueller 2008) with another.

    Pictures are padded by the largest disparity: OpenCV searches nothing in the first columns otherwise.

    Returns:
        (H, W) float32 m in the reference view, NaN where there is no match.
    """
    import cv2

    a, b = cameras[reference], cameras[other]
    relative = b.world_to_camera @ np.linalg.inv(a.world_to_camera)
    h, w = pictures[reference].shape[:2]
    Ka, Kb = a.K.copy(), b.K.copy()
    Ka[:2, 2] -= 0.5
    Kb[:2, 2] -= 0.5
    wide = (round(ROOM * w), round(ROOM * h))  # little is cut off
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        Ka,
        None,
        Kb,
        None,
        (w, h),
        relative[:3, :3],
        relative[:3, 3:].copy(),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=-1,  # keeps the focal length; OpenCV's other choices turn it negative for strongly turned pairs
    )
    for P in (P1, P2):
        P[:2, 2] += (wide[0] - w) / 2, (wide[1] - h) / 2
    maps = [cv2.initUndistortRectifyMap(K, None, R, P, wide, cv2.CV_32FC1) for K, R, P in ((Ka, R1, P1), (Kb, R2, P2))]
    left, right = (
        cv2.remap(cv2.cvtColor(p, cv2.COLOR_RGB2GRAY), *m, cv2.INTER_LINEAR)
        for p, m in zip((pictures[reference], pictures[other]), maps, strict=True)
    )
    # disparity = P2[0, 3] / z, with its sign: negative for a camera to the right.
    ends = sorted(-P2[0, 3] / z for z in (near, far))
    ends = [e + (P1[0, 2] - P2[0, 2]) for e in ends]
    low = int(np.floor(min(ends)))
    count = int(np.ceil((max(ends) - low) / 16) * 16) or 16
    pad = max(abs(low), abs(low + count)) + 8

    def match(first, second, low):
        first, second = (cv2.copyMakeBorder(p, 0, 0, pad, pad, cv2.BORDER_REPLICATE) for p in (first, second))
        block = 5
        matcher = cv2.StereoSGBM_create(
            low,
            count,
            block,
            8 * block**2,
            32 * block**2,
            uniquenessRatio=8,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
        found = matcher.compute(first, second).astype(np.float32)[:, pad:-pad] / 16
        return np.where(found < low, np.nan, found)

    forward, back = match(left, right, low), match(right, left, -(low + count - 1))
    columns = np.arange(wide[0]) - np.nan_to_num(forward, nan=1e6)
    inside = (columns >= 0) & (columns <= wide[0] - 1)
    returned = np.take_along_axis(back, np.clip(np.rint(columns), 0, wide[0] - 1).astype(int), 1)
    forward[~(inside & (np.abs(forward + returned) < 1.5))] = np.nan

    # Rectified disparity -> depth along the reference camera's own axis, at its own pixels.
    z = -P2[0, 3] / np.where(np.abs(forward) > 1e-6, forward, np.nan)
    x, y = np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64))
    rays = np.stack([(x - Ka[0, 2]) / Ka[0, 0], (y - Ka[1, 2]) / Ka[1, 1], np.ones_like(x)], -1) @ R1.T
    u = rays[..., 0] / rays[..., 2] * P1[0, 0] + P1[0, 2]
    v = rays[..., 1] / rays[..., 2] * P1[1, 1] + P1[1, 2]
    z = cv2.remap(
        z.astype(np.float32),
        u.astype(np.float32),
        v.astype(np.float32),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float("nan"),
    )
    depth = z / rays[..., 2]
    return np.where((depth > 0.5 * near) & (depth < 2 * far), depth, np.nan).astype(np.float32)


def stereo_depth(pictures: list[np.ndarray], cameras: list[Camera], points: np.ndarray) -> list[np.ndarray]:
    """`neighbours_matched`, kept where another view's depth confirms it.

    Args:
        pictures: (H, W, 3) uint8 per camera.   points: (N, 3) sparse world points, for the depth range.
    Returns:
        (H, W) float32 m per camera, NaN where unknown.
    """
    return consistent(neighbours_matched(pictures, cameras, *depth_range(cameras, points)), cameras)


def neighbours_matched(pictures: list[np.ndarray], cameras: list[Camera], near: float, far: float) -> list[np.ndarray]:
    """Every view matched with the cameras next to it: (H, W) float32 m, median of the answers, NaN where there is none."""
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


def consistent(
    depths: list[np.ndarray], cameras: list[Camera], tolerance: float = 0.02, views: int = 1
) -> list[np.ndarray]:
    """Depth maps with everything removed that fewer than `views` other maps confirm within a relative `tolerance`; (H, W) NaN there."""
    kept = []
    for c, depth in enumerate(depths):
        h, w = depth.shape
        x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
        local = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(cameras[c].K).T * depth[..., None]
        world = (local - cameras[c].world_to_camera[:3, 3]) @ cameras[c].world_to_camera[:3, :3]
        agree = np.zeros(depth.shape, int)
        for o, other in enumerate(cameras):
            if o == c:
                continue
            pixel, z = other.project(world.reshape(-1, 3))
            pixel, z = np.nan_to_num(pixel, nan=-1).reshape(h, w, 2), z.reshape(h, w)
            column, row = (np.floor(pixel[..., i]).astype(int) for i in range(2))
            inside = (column >= 0) & (column < depths[o].shape[1]) & (row >= 0) & (row < depths[o].shape[0])
            there = np.where(inside, depths[o][np.where(inside, row, 0), np.where(inside, column, 0)], np.nan)
            with np.errstate(invalid="ignore"):
                agree += np.abs(there - z) < tolerance * z
        kept.append(np.where(agree >= views, depth, np.nan).astype(np.float32))
    return kept
