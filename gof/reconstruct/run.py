"""`gof reconstruct`: a dataset's three videos to transient flame Gaussians, stage by stage."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.errors import GofError
from gof.gaussians import TransientGaussians
from gof.io.files import read_json, write_json
from gof.stages import StageLog, progress_bar


@dataclass
class ReconstructConfig:
    """Three videos -> transient flame Gaussians: result.ply and result.npz.

    Stages: motion (masks, optical flow) -> flow field (hull, tomography, fused 3D velocity) -> seeds -> optimisation of
    position, velocity, time, lifetime, opacity, scale, rotation and colour over the fire-free plates. Held-out frames
    are never read. Pictures of every stage go to OUT/stages, costs to OUT/costs.json.
    """

    dataset: tyro.conf.Positional[Path]
    """Dataset folder (holds dataset.json)."""
    out: Path = Path("out/reconstruction")
    """Folder for the result; a half-finished reconstruction there is resumed."""
    gaussians: Annotated[int, tyro.conf.arg(metavar="N")] = 60_000
    """How many Gaussians in all frames together."""
    iterations: int = 2500
    """Optimisation steps, one training picture each."""
    voxels: int = 72
    """Voxels along the longest side of the flame's box; also bounds the Gaussians' size."""
    fusion: Literal["full", "paper"] = "full"
    """How the cameras' flows become one velocity: "full" uses both image components of every camera, "paper" its eq. 5-7."""
    smooth_voxels: float = 3.0
    """Emission-weighted smoothing of the fused flow, std-dev in voxels; 0 = none."""
    opacity: float = 0.1
    """Opacity of a new Gaussian."""
    seed: int = 0
    """Random seed of the seeding and of the order of pictures."""
    json: Path | None = None
    """Also write the summary to this file."""


def reconstruct(config: ReconstructConfig) -> Path:
    """Run all stages that are not finished yet.

    Returns:
        path of result.npz.
    Raises:
        GofError: `out` holds a reconstruction made with other settings; or see the stages.
    """
    dataset, out = Dataset.open(config.dataset), config.out
    result = out / "result.npz"
    settings = {k: v for k, v in asdict(config).items() if k not in ("out", "json", "dataset")}
    settings["dataset"] = str(dataset.path.resolve().name)
    _claim(out / "settings.json", settings)
    if result.exists() and (out / "result.ply").exists():
        return result

    from gof.reconstruct import pictures
    from gof.reconstruct.flow_field import fuse_frame
    from gof.reconstruct.motion import estimate_motion
    from gof.reconstruct.seeds import sample_seeds
    from gof.reconstruct.voxels import carve, tomography

    log, rng = StageLog(out / "costs.json"), np.random.default_rng(config.seed)
    dt = dataset.frame_time_s
    if dt <= 0:
        raise GofError(f"{dataset.path}: a single frame has no motion; at least 2 training frames are needed")

    with log.measure("motion") as figures, progress_bar("motion") as progress:
        motion = estimate_motion(dataset, progress=progress)
        pictures.save_motion(out / "stages", motion)
        figures.update(frames=len(motion.frames), cameras=len(dataset.cameras))

    with log.measure("flow_field") as figures, progress_bar("flow field") as progress:
        voxels = carve(dataset.cameras, motion.mask, config.voxels)
        frames = []
        for f, k in enumerate(motion.frames):
            emission = tomography(voxels, motion.intensity[f], motion.mask[f])
            velocity, known = fuse_frame(
                voxels, motion.flow[f], motion.mask[f], emission, config.fusion, config.smooth_voxels
            )
            frames.append(
                {
                    "time_s": float(dataset.times_s[k]),
                    "emission": emission,
                    "velocity": velocity,
                    "known": known,
                    "image": motion.image[f],
                }
            )
            progress(f + 1, len(motion.frames))
        pictures.save_flow_field(out / "stages", voxels, frames[len(frames) // 2])
        figures.update(
            voxels=len(voxels.center), voxel_size_m=round(voxels.voxel_size, 5), resolution=voxels.resolution.tolist()
        )

    with log.measure("seeds") as figures:
        seeds = sample_seeds(voxels, frames, dt, config.gaussians, config.opacity, rng)
        seeds.save(out / "seeds.npz", source="gof reconstruct: seeds before optimisation")
        figures.update(gaussians=len(seeds))

    from gof.reconstruct.optimize import Schedule, optimize

    checkpoint = out / "checkpoint.npz"
    with (
        log.measure("optimize", iterations=config.iterations, gaussians=len(seeds)),
        progress_bar("optimise") as progress,
    ):
        gaussians = optimize(
            seeds,
            voxels.voxel_size,
            dt,
            motion,
            dataset.times_s,
            dataset.cameras,
            Schedule(config.iterations),
            rng,
            checkpoint,
            progress,
        )
    gaussians.save(out / "result.ply", source=f"gof reconstruct {dataset.meta['name']}")
    gaussians.save(result, source=f"gof reconstruct {dataset.meta['name']}")
    checkpoint.unlink(missing_ok=True)
    return result


def _claim(path: Path, settings: dict) -> None:
    """Make sure a folder holds the work of one set of settings only."""
    if not path.exists():
        write_json(path, settings)
        return
    before = read_json(path)
    changed = sorted(k for k in settings.keys() | before.keys() if settings.get(k) != before.get(k))
    if changed:
        raise GofError(
            f"{path.parent} holds a reconstruction with other settings ({', '.join(changed)} differ); "
            "choose another --out or remove the folder"
        )


def main(argv: list[str]) -> int:
    """`gof reconstruct DATASET [--out DIR] [--json FILE]`; see --help."""
    config = tyro.cli(ReconstructConfig, prog="gof reconstruct", args=argv)
    result = reconstruct(config)
    stages = [asdict(s) for s in StageLog(config.out / "costs.json").stages()]
    summary = {"result": str(result), "gaussians": len(TransientGaussians.load(result)), "stages": stages}
    if config.json:
        write_json(config.json, summary)
    for stage in stages:
        print(f"{stage['name']:<12} {stage['seconds']:8.1f} s {stage['peak_mb']:8.0f} MB")
    print(f"{summary['gaussians']} Gaussians -> {result}")
    return 0
