"""`gof background`: the fire-free scene as static Gaussians, from the plates and their depth (paper, "Static Scene").

For views that no camera took; from the cameras themselves a plate is exact. Seeds are the back-projected depth maps.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.cameras import Camera
from gof.costs import StageLog
from gof.dataset import Dataset
from gof.errors import DataFormatError, GofError
from gof.gaussians import TransientGaussians
from gof.ingest import depth as depth_maps
from gof.ingest.stereo import stereo_depth
from gof.io.files import write_json
from gof.progress import progress_bar
from gof.reconstruct.shrink import shrink


@dataclass
class BackgroundConfig:
    """The scene without fire as static Gaussians: background.npz and background.ply, for views that no camera took."""

    dataset: tyro.conf.Positional[Path]
    """Dataset folder. Uses its depth/CAMERA.npy (from `gof static --depth`), else stereo between its plates."""
    out: Path
    """Folder for the result; a finished one there is kept."""
    steps: int = 3000
    """Optimisation steps, one plate each; the paper's are 10 000."""
    gaussians: int = 120_000
    """At most so many."""
    longest_side: int = 640
    """Pictures with a longer side, in pixels, are shrunk to it."""
    depth_term: bool = True
    """Hold the Gaussians to the depth maps."""
    depth_weights: Path | None = None
    """Folder of a Depth-Anything-V2 checkpoint that completes stereo depth; without it edges of the plate do."""
    flame: Path | None = None
    """Result of `gof reconstruct` to add: scene.npz and scene.ply hold both."""
    seed: int = 0
    """Random seed of the order of pictures and of splitting."""
    json: Path | None = None
    """Also write the summary to this file."""


def make_background(config: BackgroundConfig) -> Path:
    """Run what is not there yet; returns the path of background.npz.

    Raises:
        GofError: no depth can be had; see `stereo_depth` and `depth.whole_depth`.
    """
    result = config.out / "background.npz"
    if not result.exists():
        from gof.reconstruct.splatting import optimize_background

        config.out.mkdir(parents=True, exist_ok=True)
        full, log = Dataset.open(config.dataset), StageLog(config.out / "costs.json")
        dataset = shrink(full, config.longest_side)
        plates = [dataset.static(c) for c in range(len(dataset.cameras))]
        with log.measure("depth"):
            depths = plate_depths(dataset, plates, config.depth_weights)
        rng = np.random.default_rng(config.seed)
        with log.measure("background") as figures, progress_bar("background") as progress:
            seeds = seed_background(dataset.cameras, plates, depths, config.gaussians // 2, rng)
            gaussians = optimize_background(
                seeds,
                dataset.cameras,
                plates,
                depths if config.depth_term else None,
                config.steps,
                config.gaussians,
                rng,
                progress,
            )
            figures.update(gaussians=len(gaussians), steps=config.steps)
        source = f"gof background {full.meta['name']}"
        gaussians.save(config.out / "background.ply", source=source)
        gaussians.save(result, source=source)
    if config.flame is not None:
        both = TransientGaussians.concatenate([TransientGaussians.load(result), TransientGaussians.load(config.flame)])
        for name in ("scene.npz", "scene.ply"):
            both.save(config.out / name, source="gof background and gof reconstruct")
    return result


def plate_depths(dataset: Dataset, plates: list[np.ndarray], weights: Path | None) -> list[np.ndarray]:
    """C x (H, W) camera depth in m, everywhere: the dataset's own maps, else stereo between the plates, completed."""
    files = [dataset.path / "depth" / f"{camera.name}.npy" for camera in dataset.cameras]
    pictures = [np.uint8(np.rint(255 * plate)) for plate in plates]
    if all(file.is_file() for file in files):
        found = [np.load(file, allow_pickle=False) for file in files]
        import cv2

        for file, depth in zip(files, found, strict=True):
            if depth.ndim != 2 or not (np.isfinite(depth) & (depth > 0)).all():
                raise DataFormatError(f"{file}: not an (H, W) map of positive depths; run gof static --depth again")
        # Nearest: a mean of two surfaces is a place where nothing is.
        return [
            cv2.resize(d.astype(np.float32), p.shape[1::-1], interpolation=cv2.INTER_NEAREST)
            for d, p in zip(found, plates, strict=True)
        ]
    if len(plates) < 2:
        raise GofError(f"{dataset.path}: one camera has no stereo depth; give depth/{files[0].name}")
    points = np.array(dataset.meta.get("points", []), np.float64).reshape(-1, 3)
    partial = stereo_depth(pictures, dataset.cameras, points)
    return [depth_maps.whole_depth(d, picture, weights) for d, picture in zip(partial, pictures, strict=True)]


def seed_background(
    cameras: list[Camera], plates: list[np.ndarray], depths: list[np.ndarray], budget: int, rng: np.random.Generator
) -> TransientGaussians:
    """At most `budget` pixels of the plates as Gaussians at their depth, as large as the way to their three nearest neighbours."""
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


def main(argv: list[str]) -> int:
    """`gof background DATASET --out DIR`; see --help."""
    config = tyro.cli(BackgroundConfig, prog="gof background", args=argv)
    result = make_background(config)
    stages = StageLog(config.out / "costs.json").stages()
    summary = {
        "result": str(result),
        "gaussians": len(TransientGaussians.load(result)),
        "stages": [asdict(s) for s in stages],
    }
    if config.json:
        write_json(config.json, summary)
    for stage in stages:
        print(f"{stage.name:<12} {stage.seconds:8.1f} s {stage.peak_mb:8.0f} MB")
    print(f"{summary['gaussians']} Gaussians -> {result}")
    return 0
