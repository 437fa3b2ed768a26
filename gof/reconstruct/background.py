"""The fire-free scene as static Gaussians, from the plates and their depth (paper, "Static Scene").

For views that no camera took; from the cameras themselves a plate is exact. Seeds are the back-projected depth maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from gof.core.cameras import Camera
from gof.core.costs import StageLog
from gof.core.errors import DataFormatError, GofError
from gof.core.files import path_in, stamp
from gof.core.gaussians import TransientGaussians
from gof.core.npz import read_npy
from gof.core.records import claim, is_replaced
from gof.dataset import Dataset
from gof.dataset.leaks import require_no_leaks
from gof.dataset.poses import FILE as POSES
from gof.host.options import require_whole
from gof.host.terminal import progress_bar
from gof.ingest import depth as depth_maps
from gof.ingest.stereo import stereo_depth
from gof.reconstruct.shrink import shrink

LEAST = (
    ("steps", "--steps", 1),
    ("gaussians", "--gaussians", 2),
    ("longest_side", "--max-size", 16),
)

MADE = ("background.npz", "background.ply", "scene.npz", "scene.ply", "costs.json", "background.json")  # in the folder


@dataclass(frozen=True)
class BackgroundOptions:
    """Settings of the reconstruction of the still scene.

    Attributes:
        steps: of the optimisation, one plate each; the paper's are 10 000.
        gaussians: at most so many.
        longest_side: px; plates with a longer side are shrunk to it.
        depth_term: hold the Gaussians to the depth maps.
        depth_weights: folder of a Depth-Anything-V2 checkpoint that completes stereo depth; None: the plate's edges do.
        seed: of the order of plates and of splitting.
    """

    steps: int = 3000
    gaussians: int = 120_000
    longest_side: int = 640
    depth_term: bool = True
    depth_weights: Path | None = None
    seed: int = 0

    def __post_init__(self):
        for name, option, least in LEAST:
            require_whole(option, getattr(self, name), least)
        require_whole("seed", self.seed, 0)


@dataclass(frozen=True)
class BackgroundSettings:
    """background.json: what a background is made with.

    Attributes:
        dataset: which one, see `gof.dataset.Dataset.identity`.
        depth_weights: which checkpoint, as `gof.core.files.stamp` of its folder.
        steps, gaussians, longest_side, depth_term, seed: see `BackgroundOptions`.
    """

    SCHEMA: ClassVar[str] = "gof-background-settings"
    VERSION: ClassVar[int] = 1

    dataset: str
    steps: int
    gaussians: int
    longest_side: int
    depth_term: bool
    depth_weights: str | None
    seed: int

    @classmethod
    def of(cls, dataset: Dataset, options: BackgroundOptions) -> BackgroundSettings:
        depths = [f"depth/{camera.name}.npy" for camera in dataset.cameras]
        weights = options.depth_weights and stamp(options.depth_weights, ("config.json", "model.safetensors"))
        given = asdict(options) | {"depth_weights": weights}
        return cls(dataset.identity(POSES, *depths), **given)

    def claim(self, out: Path) -> None:
        """Write these options to `out`. Raises GofError: it holds a background made with others."""
        claim(out / "background.json", self, out / "background.npz", _option_of)

    def is_replaced(self, out: Path, overwrite: bool) -> bool:
        """Return whether `out` holds a background of other options that is to be replaced: one without a result always,
        as none is resumed. Raises GofError: it holds one, and `overwrite` is not set."""
        made = out / "background.npz"
        return is_replaced(out / "background.json", self, made, overwrite or not made.exists(), _option_of)


def _option_of(field: str) -> str:
    """Return the option of `gof background` that gives a field of the settings; the field's own name without one."""
    return {name: option for name, option, _ in LEAST}.get(field, field)


def make_background(folder: Path, out: Path, options: BackgroundOptions, overwrite: bool = False) -> TransientGaussians:
    """Reconstruct the still scene of a dataset: out/background.npz and .ply; a finished one there is kept.

    Args:
        overwrite: replace one made with other settings.
    Raises:
        GofError: `out` holds one made with other settings, and not `overwrite`; no depth, see `plate_depths`.
        LeakError: the plates were made from a held-out frame.
    """
    result = out / "background.npz"
    full = Dataset.open(folder)
    settings = BackgroundSettings.of(full, options)
    replaced = settings.is_replaced(out, overwrite)
    if result.exists() and not replaced:
        return TransientGaussians.load(result)
    require_no_leaks(full)
    dataset = shrink(full, options.longest_side)
    plates = [dataset.static(c) for c in range(len(dataset.cameras))]
    for name in MADE if replaced else ():
        (out / name).unlink(missing_ok=True)
    settings.claim(out)
    gaussians = still_gaussians(dataset, plates, options, StageLog(out / "costs.json"))
    for path in (out / "background.ply", result):  # the .npz last: it says that the result is finished
        gaussians.save(path, source=f"gof background {full.description.name}")
    return gaussians


def still_gaussians(
    dataset: Dataset, plates: Sequence[np.ndarray], options: BackgroundOptions, log: StageLog
) -> TransientGaussians:
    """Return the still scene of a dataset: seeds at the depth of its plates, and their optimisation.

    Args:
        dataset: at the size of the plates.   plates: C x (H, W, 3) display values.
        options: `longest_side` is ignored.   log: gets the stages "depth" and "background".
    Raises:
        GofError: see `plate_depths`.
    """
    from gof.reconstruct.splatting import optimize_background

    rng = np.random.default_rng(options.seed)
    with log.measure("depth"):
        depths = plate_depths(dataset, plates, options.depth_weights)
    with log.measure("background") as figures, progress_bar("background") as progress:
        seeds = seed_background(dataset.cameras, plates, depths, options.gaussians // 2, rng)
        gaussians = optimize_background(
            seeds,
            dataset.cameras,
            plates,
            depths if options.depth_term else None,
            options.steps,
            options.gaussians,
            rng,
            progress,
        )
        figures.update(gaussians=len(gaussians), steps=options.steps)
    return gaussians.measured_from(dataset.datum)


def add_flame(background: TransientGaussians, flame: TransientGaussians, out: Path) -> None:
    """Write out/scene.npz and .ply: the still scene and a flame's Gaussians together."""
    both = TransientGaussians.concatenate([background, flame])
    for name in ("scene.npz", "scene.ply"):
        both.save(out / name, source="gof background and gof reconstruct")


def plate_depths(dataset: Dataset, plates: Sequence[np.ndarray], weights: Path | None) -> list[np.ndarray]:
    """C x (H, W) camera depth in m, everywhere: the dataset's own maps, else stereo between the plates, completed.

    Args:
        plates: (H, W, 3) display values in [0, 1] per camera.
    Raises:
        DataFormatError: a map of the dataset is not one of positive depths.
        GofError: no map, and a single camera or nothing to match; see `depth.whole_depth`.
    """
    files = [path_in(dataset.path, f"depth/{camera.name}.npy") for camera in dataset.cameras]
    if all(file.is_file() for file in files):
        return [_stored_depth(file, plate.shape[1::-1]) for file, plate in zip(files, plates, strict=True)]
    if len(plates) < 2:
        raise GofError(f"{dataset.path}: one camera has no stereo depth; give depth/{files[0].name}")
    pictures = [np.rint(255 * plate).astype(np.uint8) for plate in plates]
    partial = stereo_depth(pictures, dataset.cameras, dataset.sparse_points())
    return [depth_maps.whole_depth(d, picture, weights) for d, picture in zip(partial, pictures, strict=True)]


def _stored_depth(file: Path, size: Sequence[int]) -> np.ndarray:
    """(H, W) float32 m of a depth map of the dataset, at `size` (width, height)."""
    import cv2

    depth = read_npy(file)
    if depth.ndim != 2 or not (np.isfinite(depth) & (depth > 0)).all():
        again = f"gof depth {file.parents[1]} --plates --overwrite"
        raise DataFormatError(f"{file}: not an (H, W) map of positive depths; make it again with: {again}")
    # Nearest: a mean of two surfaces is a place where nothing is.
    return cv2.resize(depth.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)


def seed_background(
    cameras: list[Camera], plates: Sequence[np.ndarray], depths: list[np.ndarray], budget: int, rng: np.random.Generator
) -> TransientGaussians:
    """At most `budget` pixels of the plates as Gaussians at their depth, as large as the way to their neighbours.

    Args:
        plates: C x (H, W, 3) display values.   depths: C x (H, W) m.
    """
    from scipy.spatial import cKDTree

    clouds = [
        depth_maps.back_project(d, plate, camera) for d, plate, camera in zip(depths, plates, cameras, strict=True)
    ]
    points, colors = (np.concatenate(x) for x in zip(*clouds, strict=True))
    chosen = rng.permutation(len(points))[:budget]
    points, colors = points[chosen], colors[chosen]
    apart = cKDTree(points).query(points, k=min(4, len(points)))[0]
    size = np.sqrt((apart[:, 1:] ** 2).mean(1)) if len(points) > 1 else np.ones(len(points))
    n = len(points)
    return TransientGaussians(
        position=points,
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.tile(np.maximum(size, 1e-7 * np.ptp(points, axis=0).max() + 1e-12)[:, None], (1, 3)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.1),
        color=colors,
        dynamic=np.zeros(n, bool),
    )
