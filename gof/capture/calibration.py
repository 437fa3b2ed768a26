"""`gof capture calibrate`: footage of a ChArUco board -> intrinsics of every camera, the file that `gof static --cameras` reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.capture.charuco import Charuco
from gof.errors import GofError
from gof.footage import distinct_names, stated_frames, stored_frames
from gof.io.files import write_json
from gof.lens import Lens
from gof.progress import progress_bar

MINIMUM_VIEWS = 8
GRID = (8, 6)  # cells of the picture for the coverage, across and down


@dataclass(frozen=True)
class Calibration:
    """A camera mode's lens and how well it is known.

    Args:
        rms_px: reprojection error over all corners.
        views: pictures used.
        focal_sigma_px: standard error of the focal lengths, from the scatter of the corners.
        coverage: share of the picture's 8 x 6 cells in which a corner was seen. Outside, distortion is extrapolated.
    """

    lens: Lens
    rms_px: float
    views: int
    focal_sigma_px: float
    coverage: float

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready camera entry; `Lens.from_dict` reads it."""
        figures = {"rms_px": self.rms_px, "focal_sigma_px": self.focal_sigma_px, "coverage": self.coverage}
        return self.lens.to_dict() | {k: round(v, 4) for k, v in figures.items()} | {"views": self.views}

    def warnings(self) -> list[str]:
        """What could be better, and how."""
        out = []
        if self.coverage < 0.7:
            out.append(
                f"corners were seen in {self.coverage:.0%} of the picture only; bring the target to its borders and corners"
            )
        if self.rms_px > 0.7:
            out.append(
                f"the corners miss the model by {self.rms_px:.2f} px; is the target flat, the footage sharp, the zoom fixed?"
            )
        if self.focal_sigma_px > 0.003 * self.lens.K[0, 0]:
            out.append(
                f"the focal length is known to {self.focal_sigma_px:.1f} px only; tilt the target more (30 to 45 degrees, all ways)"
            )
        return out


def sharpest(frames: Iterable[np.ndarray], count: int) -> list[np.ndarray]:
    """At least `count` (if there are so many) and fewer than 2 `count` grey pictures spread evenly over (H, W, 3) RGB
    frames: the sharpest of each stretch, in one pass."""
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

    Views whose reprojection error is above three times the median are left out and the rest is fitted again (Zhang's method,
    `cv2.calibrateCameraExtended`).

    Raises:
        GofError: pictures of different sizes; too few show the target; they do not determine the focal length.
    """
    import cv2

    object_points, image_points, size, seen = [], [], None, 0
    for seen, grey in enumerate(pictures, 1):
        if size not in (None, grey.shape[::-1]):
            raise GofError(
                f"picture {seen} is {grey.shape[::-1]}, the ones before {size} pixels; calibrate one camera mode at a time"
            )
        size = grey.shape[::-1]
        if found := target.corners(grey):
            object_points.append(found[0])
            image_points.append(found[1])
        progress(seen)
    if len(object_points) < MINIMUM_VIEWS:
        raise GofError(
            f"{len(object_points)} of {seen} pictures show at least 8 corners of the {target.columns} x {target.rows} target, "
            f"{MINIMUM_VIEWS} are needed. Show it whole, sharp and evenly lit, from many angles; check --columns and --rows"
        )
    for _ in range(3):
        rms, K, distortion, turns, _, sigma, _, per_view = cv2.calibrateCameraExtended(
            object_points, image_points, size, None, None
        )
        good = per_view.ravel() <= 3 * np.median(per_view)
        if good.all() or good.sum() < MINIMUM_VIEWS:
            break
        object_points = [o for o, g in zip(object_points, good, strict=True) if g]
        image_points = [i for i, g in zip(image_points, good, strict=True) if g]
    focal, spread = K[[0, 1], [0, 1]], sigma.ravel()[:2]
    # Parallel views leave the focal length open; OpenCV then keeps its first guess and calls it certain.
    normals = np.stack([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilt = np.degrees(np.arccos(np.clip(normals @ normals.mean(0) / np.linalg.norm(normals.mean(0)), -1, 1)).mean())
    if not np.isfinite(K).all() or not np.isfinite(distortion).all() or tilt < 4 or (spread > 0.02 * focal).any():
        raise GofError(
            f"the views do not determine the focal length: their directions differ by {tilt:.0f} degrees on average (focal length "
            f"{focal[0]:.0f} +- {spread[0]:.0f} px). Tilt the target by 30 to 45 degrees, left, right, up and down"
        )
    cells = np.floor(np.concatenate(image_points)[:, 0] / size * GRID).astype(int)
    inside = cells[((cells >= 0) & (cells < GRID)).all(1)]
    coverage = len(np.unique(inside, axis=0)) / (GRID[0] * GRID[1])
    return Calibration(
        Lens(*size, K, distortion.ravel()), float(rms), len(object_points), float(spread.max()), coverage
    )


@dataclass(frozen=True)
class CalibrateConfig:
    """Intrinsics of every camera from footage of the ChArUco target (`gof capture target` draws it).

    Film in the mode the fire will be filmed in: same resolution, rate, zoom and stabilisation off. Move the target slowly
    for about 20 seconds: near, far, tilted all ways, out to the corners of the picture. The file goes to gof static --cameras.
    """

    footage: tyro.conf.Positional[list[Path]]
    """One video or folder of photos per camera, in the order of the fire's videos."""
    out: Path
    """JSON file to write."""
    target: tyro.conf.OmitArgPrefixes[Charuco] = field(default_factory=Charuco)
    views: int = 40
    """Use 1 to 2 times so many frames of a video, the sharpest of equal stretches; photos are all used."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str]) -> int:
    """Calibrate every camera and write the file."""
    config = tyro.cli(CalibrateConfig, prog="gof capture calibrate", args=argv)
    if config.out.exists():
        raise GofError(f"{config.out}: exists; remove it or choose another --out")
    if not config.footage:
        raise GofError("name the footage of the target, one video or folder of photos per camera")
    config.target.board()  # impossible sizes are said before anything is read
    cameras = []
    for name, path in zip(distinct_names(config.footage), config.footage, strict=True):
        frames = stated_frames(path) or 0
        with progress_bar(f"read {name}") as update:
            stream = (update(k, max(k, frames)) or frame for k, frame in enumerate(stored_frames(path), 1))
            pictures = sharpest(stream, frames if path.is_dir() else config.views)
        with progress_bar(f"find the target in {name}") as update:
            total = len(pictures)
            try:
                found = calibrate(pictures, config.target, lambda done, u=update, n=total: u(done, n))
            except GofError as e:
                raise GofError(f"{path}: {e}") from e
        lens = found.lens
        print(
            f"{name}: focal {lens.K[0, 0]:.1f}, {lens.K[1, 1]:.1f} +- {found.focal_sigma_px:.1f} px, centre {lens.K[0, 2]:.1f}, "
            f"{lens.K[1, 2]:.1f}, corners within {found.rms_px:.3f} px rms in {found.views} views over {found.coverage:.0%} of the picture"
        )
        for warning in found.warnings():
            print(f"warning: {name}: {warning}")
        cameras.append({"name": name} | found.to_dict())
    result = {"schema": "gof-cameras", "version": 1, "cameras": cameras}
    write_json(config.out, result)
    print(f"wrote {config.out}; next: gof static VIDEO... --cameras {config.out}")
    if config.json:
        write_json(config.json, result)
    return 0
