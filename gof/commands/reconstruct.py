"""`gof reconstruct`: a dataset's three videos to transient flame Gaussians, stage by stage."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from gof.costs import StageLog
from gof.dataset import Dataset
from gof.errors import GofError
from gof.gaussians import TransientGaussians
from gof.io.files import only_run_in, read_json, write_json
from gof.plates import save_plates
from gof.progress import progress_bar
from gof.reconstruct.optical_flow import FlowName
from gof.reconstruct.presets import METHODS, PRESETS, step_ms

Ablation = Literal["none", "no-sync", "rand-flow", "joint-opt", "no-mask"]


@dataclass
class ReconstructConfig:
    """Three videos -> transient flame Gaussians: result.ply and result.npz.

    Stages: motion (masks, optical flow) -> flow field (hull, tomography, fused 3D velocity) -> seeds -> optimisation of
    position, velocity, time, lifetime, opacity, scale, rotation and colour over the plates in the fire's light, which may change a little and are kept
    in OUT/plates. Held-out frames are read for scores only. Pictures of every stage go to OUT/stages, costs to OUT/costs.json, scores on held-out
    pictures along the way to OUT/curve.json. `gof view OUT` shows the flame while it is being optimised.
    """

    dataset: tyro.conf.Positional[Path]
    """Dataset folder (holds dataset.json)."""
    out: Path = Path("out/reconstruction")
    """Folder for the result; a half-finished reconstruction there is resumed."""
    preset: Literal["preview", "draft", "standard", "paper"] = "preview"
    """How much work; sets the next four, each of which can be given by itself."""
    gaussians: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How many Gaussians in all frames together."""
    iterations: int | None = None
    """Optimisation steps, one training picture each."""
    voxels: int | None = None
    """Voxels along the longest side of the flame's box; also bounds the Gaussians' size."""
    longest_side: int | None = None
    """Pictures with a longer side, in pixels, are shrunk to it."""
    method: Literal["gof", "paper"] = "gof"
    """Ours, or the paper's own choices wherever they differ (see gof.reconstruct.presets.METHODS)."""
    flow: FlowName = "dis"
    """Optical flow of the pictures: OpenCV's DIS, DeepFlow or TV-L1, or MEMFOF with --flow-weights."""
    flow_weights: Path | None = None
    """Folder with config.json and model.safetensors of a MEMFOF checkpoint; never downloaded."""
    flow_prior: bool = True
    """Correct the fused flow, which follows texture, to the gas' own velocity, as learnt on simulated flames (ours; z must be up)."""
    until: Literal["motion", "flow-field", "seeds", "result"] = "result"
    """Stop after this stage and look at its pictures; without it the same command goes on."""
    ablation: Ablation = "none"
    """Leave a part of the method out, as in the paper's ablations (see gof.reconstruct.ablations)."""
    seed: int = 0
    """Random seed of the seeding and of the order of pictures."""
    json: Path | None = None
    """Also write the summary to this file."""

    def __post_init__(self):
        for name, value in asdict(PRESETS[self.preset]).items():
            if getattr(self, name) is None:
                setattr(self, name, value)


def reconstruct(config: ReconstructConfig) -> Path:
    """Run the stages, up to `until`; a finished result is kept, an interrupted optimisation resumed.

    Returns:
        path of result.npz; or of the folder of pictures, OUT/stages, when stopped before.
    Raises:
        GofError: `out` holds a reconstruction made with other settings, or another run is at work there; or see the stages.
    """
    with only_run_in(config.out):
        return _run_stages(config)


def _run_stages(config: ReconstructConfig) -> Path:
    full, out, method = Dataset.open(config.dataset), config.out, METHODS[config.method]
    result = out / "result.npz"
    settings = {
        k: v
        for k, v in asdict(config).items()
        if k not in ("out", "json", "dataset", "preset", "flow_weights", "until")
    }
    settings["dataset"] = str(full.path.resolve().name)
    _claim(out / "settings.json", settings)
    if result.exists() and (out / "result.ply").exists():
        return result

    from gof.reconstruct import ablations
    from gof.reconstruct import stage_images as pictures
    from gof.reconstruct.flow_field import fuse_frame
    from gof.reconstruct.flow_prior import FlowPrior
    from gof.reconstruct.heldout import HeldOut
    from gof.reconstruct.motion import estimate_motion
    from gof.reconstruct.optical_flow import flow_method
    from gof.reconstruct.seeds import LIFETIME_FRAMES, lifetime_s, sample_seeds
    from gof.reconstruct.shrink import shrink
    from gof.reconstruct.voxels import carve, tomography

    flow = flow_method(config.flow, config.flow_weights)
    log, rng = StageLog(out / "costs.json"), np.random.default_rng(config.seed)
    dataset, dt = shrink(full, config.longest_side), full.frame_time_s
    if len(dataset.train_frames) < 2:
        raise GofError(
            f"{dataset.path}: a single frame has no motion; at least 2 training frames are needed, "
            f"splits.train has {len(dataset.train_frames)}"
        )
    pixels = dataset.cameras[0].width * dataset.cameras[0].height
    expected = config.iterations * step_ms(config.gaussians, pixels) / 1e3
    print(f"{config.iterations} steps: about {max(expected / 60, 0.1):.1f} min on two free CPU cores", file=sys.stderr)

    with log.measure("motion") as figures, progress_bar("motion") as progress:
        motion = estimate_motion(dataset, method.lit_plates, flow=flow, progress=progress)
        motion = ablations.change_plates(config.ablation, motion)
        pictures.save_motion(out / "stages", motion)
        figures.update(frames=len(motion.frames), cameras=len(dataset.cameras))
    if config.until == "motion":
        return out / "stages"

    with log.measure("flow_field") as figures, progress_bar("flow field") as progress:
        voxels = carve(dataset.cameras, motion.mask, config.voxels)
        frames = []
        for f, k in enumerate(motion.frames):
            emission = tomography(voxels, motion.intensity[f], motion.mask[f], method.round_flame)
            velocity, known = fuse_frame(
                voxels, motion.flow[f], motion.mask[f], emission, method.fusion, method.smooth_voxels
            )
            frames.append(
                {
                    "time_s": float(dataset.times_s[k]),
                    "emission": emission,
                    "density": emission if method.seed_emission else np.ones(len(emission)),
                    "velocity": velocity,
                    "known": known,
                    "image": motion.image[f],
                }
            )
            progress(f + 1, len(motion.frames))
        if config.flow_prior and method.flow_prior:
            seen = np.stack([frame["velocity"] for frame in frames])
            gas = FlowPrior.load().correct(voxels, seen, np.stack([frame["emission"] for frame in frames]))
            for frame, velocity in zip(frames, gas, strict=True):
                frame["velocity"] = velocity
        pictures.save_flow_field(out / "stages", voxels, frames[len(frames) // 2])
        figures.update(
            voxels=len(voxels.center), voxel_size_m=round(voxels.voxel_size, 5), resolution=voxels.resolution.tolist()
        )
    if config.until == "flow-field":
        return out / "stages"

    with log.measure("seeds") as figures:
        t_sigma = lifetime_s(voxels, frames, dt) if method.short_lives else LIFETIME_FRAMES[1] * dt
        seeds = sample_seeds(voxels, frames, t_sigma, config.gaussians, method.opacity, rng)
        seeds = ablations.change_seeds(config.ablation, seeds, rng)
        seeds.save(out / "seeds.npz", source="gof reconstruct: seeds before optimisation")
        figures.update(gaussians=len(seeds), t_sigma_s=round(t_sigma, 5))

    from gof.reconstruct.optimize import Schedule, optimize

    checkpoint = out / "checkpoint.npz"
    held_out = HeldOut(full, config.longest_side)
    times_s = np.stack([dataset.camera_times_s(c)[motion.frames] for c in range(len(dataset.cameras))])
    curve = Curve(out / "curve.json", resumed=checkpoint.exists())

    def show(name: str, caption: str, gaussians: TransientGaussians, plates: list[np.ndarray]) -> None:
        image = held_out.side_by_side(gaussians, plates, near=voxels.voxel_size)
        if image is not None:
            pictures.save_picture(out / "stages", name, f"A held-out frame, above {caption}", image)

    show("4_seeds", "the seeds before any optimisation", seeds, list(motion.plate))
    if config.until == "seeds":
        return out / "stages"

    def evaluate(step: int, gaussians: TransientGaussians, plates: list[np.ndarray]) -> float | None:
        gaussians.save(out / "snapshot.npz", source=f"gof reconstruct, step {step}")  # for `gof view`
        return curve.add(step, lambda: held_out.score(gaussians, plates, near=voxels.voxel_size))

    with (
        log.measure("optimize", iterations=config.iterations, gaussians=len(seeds)),
        progress_bar("optimise") as progress,
    ):
        gaussians, plates = optimize(
            seeds,
            voxels.voxel_size,
            dt,
            motion,
            ablations.change_times(config.ablation, times_s, dt),
            dataset.cameras,
            ablations.change_schedule(
                config.ablation, Schedule(config.iterations, method.velocity_rate, method.plate_rate)
            ),
            config.seed,
            checkpoint,
            progress,
            evaluate,
        )
    show("5_result", "the result", gaussians, plates)
    save_plates(out, [camera.name for camera in dataset.cameras], plates)
    gaussians.save(out / "result.ply", source=f"gof reconstruct {dataset.meta['name']}")
    gaussians.save(result, source=f"gof reconstruct {dataset.meta['name']}")
    for path in (checkpoint, out / "snapshot.npz"):
        path.unlink(missing_ok=True)
    return result


class Curve:
    """curve.json: scores on held-out pictures against steps and seconds of optimisation (without the scoring's own)."""

    def __init__(self, path: Path, resumed: bool):
        self.path = path
        self.rows = read_json(path) if resumed and path.exists() else []
        self._start = time.perf_counter() - (self.rows[-1]["seconds"] if self.rows else 0.0)

    def add(self, step: int, score) -> float | None:
        """Call `score` and note what it returns; gives its "psnr_flame"."""
        begin = time.perf_counter()
        row = {"step": step, "seconds": round(begin - self._start, 2)} | score()
        self.rows = [*(r for r in self.rows if r["step"] < step), row]
        write_json(self.path, self.rows)
        self._start += time.perf_counter() - begin
        return row["psnr_flame"]


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
    if result.is_dir():
        print(f"stopped after {config.until}: pictures in {result}; the same command without --until goes on")
        return 0
    stages = [asdict(s) for s in StageLog(config.out / "costs.json").stages()]
    summary = {"result": str(result), "gaussians": len(TransientGaussians.load(result)), "stages": stages}
    scores = {k: v for k, v in read_json(config.out / "curve.json")[-1].items() if v is not None}
    summary["held_out"] = scores
    if config.json:
        write_json(config.json, summary)
    for stage in stages:
        print(f"{stage['name']:<12} {stage['seconds']:8.1f} s {stage['peak_mb']:8.0f} MB")
    if "psnr_flame" in scores:
        print(f"held-out pictures, flame only: {scores['psnr_flame']:.2f} dB, SSIM {scores['ssim_flame']:.3f}")
    print(f"{summary['gaussians']} Gaussians -> {result}")
    return 0
