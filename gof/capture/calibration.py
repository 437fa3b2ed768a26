"""Footage of the ChArUco target -> intrinsics of a camera mode, and how well they are known."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from gof.capture.charuco import MINIMUM_CORNERS, Charuco
from gof.core.errors import GofError
from gof.footage.lens import CalibratedCamera, Lens

MINIMUM_VIEWS = 8
BAD_VIEW = 3.0  # times the median reprojection error; such a view was blurred, or the target bent
MINIMUM_TILT_DEG = 4.0  # mean, below which the focal length is OpenCV's first guess (tests: views from one direction)
MAXIMUM_FOCAL_SPREAD = 0.02  # of the focal length
LOOK_AT = 8  # pictures, for what a target looks like that is not the stated one
WARNING_RMS_PX, MAXIMUM_RMS_PX = 0.7, 3.0  # sharp footage has 0.1 to 0.3; more is a warning, or refused
ODD_CENTRE = 0.1  # of the picture: where the optical axis may lie beside its middle
ODD_ASPECT = 0.02  # by which the focal lengths may differ; real cameras' by 0.002
GRID = (8, 6)  # cells of the picture for the coverage, across and down


@dataclass(frozen=True)
class Calibration:
    """A camera mode's lens and how well it is known.

    Args:
        rms_px: reprojection error over all corners.
        views: pictures used.
        focal_sigma_px: standard error of the focal lengths, from the scatter of the corners.
        coverage: share of the picture's 8 x 6 cells in which a corner was seen. Outside, distortion is extrapolated.
        old_layout: whether the target was one of OpenCV before 4.6, see `Charuco.has_old_layout`.
    """

    lens: Lens
    rms_px: float
    views: int
    focal_sigma_px: float
    coverage: float
    old_layout: bool = False

    def camera(self, name: str) -> CalibratedCamera:
        """Return the entry of cameras.json."""
        return CalibratedCamera(
            self.lens.width,
            self.lens.height,
            tuple(map(tuple, self.lens.K.tolist())),
            tuple(self.lens.distortion.tolist()),
            name,
            rms_px=round(self.rms_px, 4),
            focal_sigma_px=round(self.focal_sigma_px, 4),
            coverage=round(self.coverage, 4),
            views=self.views,
        )

    def warnings(self) -> list[str]:
        """Return warnings with their remedies, in words."""
        out = []
        if self.coverage < 0.7:
            out.append(
                f"corners were seen in {self.coverage:.0%} of the picture only; "
                "bring the target to its borders and corners"
            )
        (fx, _, cx), (_, fy, cy) = self.lens.K[:2]
        off = max(abs(cx / self.lens.width - 0.5), abs(cy / self.lens.height - 0.5))
        if off > ODD_CENTRE:
            out.append(
                f"the optical axis is {off:.0%} of the picture beside its middle: is the footage cropped, or the "
                "stabilisation on?"
            )
        if abs(fx / fy - 1) > ODD_ASPECT:
            out.append(
                f"the focal lengths differ ({fx:.0f} across, {fy:.0f} down): is the footage stretched, or are the "
                "target's squares no squares on the print?"
            )
        if self.rms_px > WARNING_RMS_PX:
            out.append(
                f"the corners miss the model by {self.rms_px:.2f} px; "
                "is the target flat, the footage sharp, the zoom fixed?"
            )
        if self.focal_sigma_px > 0.003 * self.lens.K[0, 0]:
            out.append(
                f"the focal length is known to {self.focal_sigma_px:.1f} px only; "
                "tilt the target more (30 to 45 degrees, all ways)"
            )
        return out


def sharpest(frames: Iterable[np.ndarray], count: int) -> list[np.ndarray]:
    """Return at least `count` (if there are so many) and fewer than 2 `count` grey pictures spread evenly over (H, W,
    3) RGB frames: the sharpest of each stretch, in one pass."""
    import cv2

    kept: list[tuple[float, np.ndarray]] = []
    stretch, filled = 1, 0  # frames per kept picture, frames seen by the last one
    for frame in frames:
        grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
        candidate = (float(cv2.Laplacian(grey, cv2.CV_32F).var()), grey)
        if kept and filled < stretch:
            kept[-1], filled = max(kept[-1], candidate, key=lambda c: c[0]), filled + 1
            continue
        if len(kept) == 2 * count - 1:
            # Every stretch takes in its neighbour; the last one goes on filling.
            kept = [max(kept[i : i + 2], key=lambda c: c[0]) for i in range(0, len(kept), 2)]
            stretch, filled = 2 * stretch, stretch + 1
            kept[-1] = max(kept[-1], candidate, key=lambda c: c[0])
            continue
        kept.append(candidate)
        filled = 1
    return [grey for _, grey in kept]


def calibrate(
    pictures: Iterable[np.ndarray], target: Charuco, progress: Callable[[int], None] = lambda done: None
) -> Calibration:
    """Intrinsics and distortion (k1, k2, p1, p2, k3) from grey pictures (H, W) uint8 of the target.

    Views whose reprojection error is above three times the median are left out and the rest is fitted again (Zhang's
    method, `cv2.calibrateCameraExtended`).

    Raises:
        GofError: pictures of different sizes; too few show the target; they do not determine the focal length.
    """
    views, size, old_layout = _find_corners(pictures, target, progress)
    fit = _fit(views, size)
    if fit.rms_px > MAXIMUM_RMS_PX:
        raise GofError(
            f"the corners miss every lens by {fit.rms_px:.1f} px rms: is the target bent, was it filmed with moving "
            "zoom, focus or stabilisation, or is the footage blurred?"
        )
    focal, spread = fit.K[[0, 1], [0, 1]], fit.focal_sigma_px
    tilt = _mean_tilt_deg(fit.turns)
    finite = np.isfinite(fit.K).all() and np.isfinite(fit.distortion).all()
    if not finite or tilt < MINIMUM_TILT_DEG or (spread > MAXIMUM_FOCAL_SPREAD * focal).any():
        raise GofError(
            f"the views do not determine the focal length: their directions differ by {tilt:.0f} degrees on average "
            f"(focal length {focal[0]:.0f} +- {spread[0]:.0f} px). Tilt the target by 30 to 45 degrees, left, right, "
            "up "
            "and down"
        )
    lens = Lens(*size, fit.K, fit.distortion)
    return Calibration(lens, fit.rms_px, len(fit.views), float(spread.max()), _coverage(fit.views, size), old_layout)


@dataclass(frozen=True)
class _TargetView:
    """Corners seen in one picture: (N, 1, 3) metres on the target and (N, 1, 2) pixels."""

    target: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True)
class _Fit:
    """OpenCV's result: K (3, 3), distortion, turns of the target (V, 3) as axis times angle, (2,) standard errors of
    the focal lengths, rms reprojection error, and the views it rests on."""

    K: np.ndarray
    distortion: np.ndarray
    turns: np.ndarray
    focal_sigma_px: np.ndarray
    rms_px: float
    views: list[_TargetView]


def _find_corners(
    pictures: Iterable[np.ndarray], target: Charuco, progress: Callable[[int], None]
) -> tuple[list[_TargetView], tuple[int, int], bool]:
    """Return the views that show enough of the target, the pictures' (width, height), and whether it has the old
    layout."""
    layouts = (False, True) if target.has_old_layout else (False,)
    found: dict[bool, list[_TargetView]] = {old: [] for old in layouts}
    size, seen = (0, 0), 0
    few: list[np.ndarray] = []
    for seen, grey in enumerate(pictures, 1):
        height, width = grey.shape
        if seen > 1 and (width, height) != size:
            raise GofError(
                f"picture {seen} is {(width, height)}, the ones before {size} pixels; calibrate one camera mode at a "
                "time"
            )
        size = (width, height)
        for old in layouts:
            if corners := target.corners(grey, old):
                found[old].append(_TargetView(*corners))
        if len(few) < LOOK_AT:
            few.append(grey)
        progress(seen)
    old_layout = max(layouts, key=lambda old: len(found[old]))
    views = found[old_layout]
    if len(views) < MINIMUM_VIEWS:
        raise GofError(
            f"{len(views)} of {seen} pictures show at least {MINIMUM_CORNERS} corners of the {target.columns} x "
            f"{target.rows} target, {MINIMUM_VIEWS} are needed. Show it whole, sharp and evenly lit, from many angles; "
            f"{target.looks_like(few) or 'check --squares'}"
        )
    return views, size, old_layout


def _fit(views: list[_TargetView], size: tuple[int, int]) -> _Fit:
    """Fit, leave bad views out, fit again, until all agree or too few are left."""
    import cv2

    for _ in range(3):
        rms, K, distortion, turns, _, sigma, _, per_view = cv2.calibrateCameraExtended(
            [v.target for v in views], [v.pixels for v in views], size, np.eye(3), np.zeros(5)
        )
        fit = _Fit(K, distortion.ravel(), np.squeeze(turns, 2), sigma.ravel()[:2], float(rms), views)
        good = per_view.ravel() <= BAD_VIEW * np.median(per_view)
        if good.all() or good.sum() < MINIMUM_VIEWS:
            break
        views = [view for view, is_good in zip(views, good, strict=True) if is_good]
    return fit


def _mean_tilt_deg(turns: np.ndarray) -> float:
    """Return the mean angle between the target's normals and their mean. Parallel views leave the focal length open;
    OpenCV then keeps its first guess and calls it certain."""
    import cv2

    normals = np.stack([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    mean = normals.mean(0)
    return float(np.degrees(np.arccos(np.clip(normals @ mean / np.linalg.norm(mean), -1, 1)).mean()))


def _coverage(views: list[_TargetView], size: tuple[int, int]) -> float:
    """Return share of the picture's cells in which a corner was seen."""
    cells = np.floor(np.concatenate([v.pixels for v in views])[:, 0] / size * GRID).astype(int)
    inside = cells[((cells >= 0) & (cells < GRID)).all(1)]
    return len(np.unique(inside, axis=0)) / (GRID[0] * GRID[1])
