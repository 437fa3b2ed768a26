"""Which stereo on the plates: semi-global matching or a plane sweep, against a generated scene's true depth.

python -m gof_benchmark.evidence.static_depth DATASET prints coverage and error of both, before and after the check between views.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from gof.cameras import Camera
from gof.dataset import Dataset
from gof.ingest.stereo import consistent, neighbours_matched

CENSUS_SIDE = 9  # pixels; census is blind to exposure and gain, which differ between cameras


def census(grey: np.ndarray, side: int = CENSUS_SIDE) -> np.ndarray:
    """(H, W, words) uint64: which pixels of a side x side window are darker than its centre (Zabih & Woodfill 1994).

    Every second pixel of the window is compared; that keeps the window's size at a quarter of the bits.
    """
    h, w = grey.shape
    r = side // 2
    padded = np.pad(grey.astype(np.float32), r, mode="edge")
    bits, k = np.zeros((h, w), np.uint64), 0
    for dy in range(0, side, 2):
        for dx in range(0, side, 2):
            if (dy, dx) != (r, r):
                bits |= (padded[dy : dy + h, dx : dx + w] < grey).astype(np.uint64) << np.uint64(k)
                k += 1
    return bits


def plane_sweep(
    pictures: list[np.ndarray],
    cameras: list[Camera],
    reference: int,
    near: float,
    far: float,
    planes: int = 96,
    window: int = 7,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth of one view by sweeping planes parallel to it (Collins 1996), equally spaced in inverse depth.

    The cost is the census difference, averaged over a guided window; at each pixel the better half of the other views
    counts (one may be hidden). The best plane is refined by a parabola.

    Args:
        pictures: (H, W, 3) uint8 per camera.   near, far: m, 0 < near < far.
    Returns:
        depth (H, W) float32 m, and confidence (H, W) in [0, 1]: how much the second-best distinct plane is worse.
    """
    import cv2

    if not 0 < near < far:
        raise ValueError(f"near {near} and far {far} must satisfy 0 < near < far")
    grey = [cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in pictures]
    codes = census(grey[reference])
    others = [c for c in range(len(cameras)) if c != reference]
    inverse = np.linspace(1 / far, 1 / near, planes)
    h, w = grey[reference].shape
    K_inv = np.linalg.inv(cameras[reference].K)
    x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ K_inv.T
    bits = (CENSUS_SIDE // 2 + 1) ** 2
    cost = np.empty((planes, h, w), np.float32)
    for p, rho in enumerate(inverse):
        views = []
        for c in others:
            relative = cameras[c].world_to_camera @ np.linalg.inv(cameras[reference].world_to_camera)
            seen = rays @ relative[:3, :3].T + rho * relative[:3, 3]
            z = np.maximum(seen[..., 2], 1e-9)
            uv = seen[..., :2] / z[..., None] @ cameras[c].K[:2, :2].T + cameras[c].K[:2, 2] - 0.5
            uv = np.where(seen[..., 2:] > 1e-9, uv, -1e4).astype(np.float32)
            warped = cv2.remap(grey[c], uv[..., 0], uv[..., 1], cv2.INTER_LINEAR)
            inside = (uv[..., 0] >= 0) & (uv[..., 0] <= w - 1) & (uv[..., 1] >= 0) & (uv[..., 1] <= h - 1)
            differing = _popcount(census(warped) ^ codes).astype(np.float32) / bits
            views.append(np.where(inside, differing, 0.5))
        views = np.sort(np.stack(views), axis=0)[: max(1, (len(views) + 1) // 2)]
        cost[p] = cv2.boxFilter(views.mean(0), -1, (window, window))
    return _best(cost, inverse)


def _popcount(x: np.ndarray) -> np.ndarray:
    bytes_ = np.ascontiguousarray(x).view(np.uint8).reshape(*x.shape, 8)
    return _BITS[bytes_].sum(-1)


_BITS = np.array([bin(i).count("1") for i in range(256)], np.uint8)


def _best(cost: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest cost per pixel, refined between planes, and its lead over planes that are not neighbours."""
    planes = len(cost)
    k = cost.argmin(0)
    inner = np.clip(k, 1, planes - 2)
    a, b, c = (np.take_along_axis(cost, (inner + d)[None], 0)[0] for d in (-1, 0, 1))
    bend = a - 2 * b + c
    shift = np.where((bend > 1e-6) & (k == inner), np.clip((a - c) / (2 * np.maximum(bend, 1e-6)), -0.5, 0.5), 0)
    rho = np.interp(k + shift, np.arange(planes), inverse)
    best = np.take_along_axis(cost, k[None], 0)[0]
    index = np.arange(planes)[:, None, None]
    second = np.where(np.abs(index - k) > 2, cost, np.inf).min(0)
    return (1 / rho).astype(np.float32), np.clip(1 - best / np.maximum(second, 1e-6), 0, 1).astype(np.float32)


def score(name: str, found: np.ndarray, truth: np.ndarray, seconds: float) -> str:
    """One line: covered share, median relative error, share of the covered within 2 % and 5 %."""
    known = np.isfinite(truth) & (truth < 1e6)
    both = known & np.isfinite(found)
    error = np.abs(found[both] - truth[both]) / truth[both]
    return (
        f"{name:<28} cover {both.sum() / known.sum():.2f}  median {np.median(error) if both.any() else np.nan:.4f}  "
        f"<2% {(error < 0.02).mean():.3f}  <5% {(error < 0.05).mean():.3f}  {seconds:.1f} s"
    )


def main(folder: str) -> None:
    """Score both methods in all cameras of a generated dataset."""
    import OpenEXR

    dataset = Dataset.open(folder)
    views = range(len(dataset.cameras))
    pictures = [np.uint8(np.rint(255 * dataset.static(c))) for c in views]
    truth = [
        np.array(OpenEXR.File(str(dataset.file(c, "exr", 0)), separate_channels=True).channels()["Z"].pixels)
        for c in views
    ]
    depth = np.concatenate([t[t < 1e6] for t in truth])
    near, far = np.percentile(depth, 1) / 1.2, np.percentile(depth, 99) * 1.2

    def swept():
        return [plane_sweep(pictures, dataset.cameras, c, near, far)[0] for c in views]

    def matched():
        return neighbours_matched(pictures, dataset.cameras, near, far)

    for name, method in (("semi-global", matched), ("plane sweep", swept)):
        start = time.perf_counter()
        depths = method()
        seconds = (time.perf_counter() - start) / len(depths)
        for label, maps in ((name, depths), (f"{name}, checked", consistent(depths, dataset.cameras))):
            for camera, found, true in zip(dataset.cameras, maps, truth, strict=True):
                print(score(f"{label} {camera.name}", found, true, seconds))


if __name__ == "__main__":
    main(sys.argv[1])
