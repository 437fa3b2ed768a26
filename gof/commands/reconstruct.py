"""`gof reconstruct`: a dataset's three videos to transient flame Gaussians, stage by stage."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof.commands.each import folder_of_each, run_each
from gof.commands.everywhere import may_overwrite, next_to
from gof.commands.read import Pixels, Preset, read_options
from gof.core.cameras import in_words, sizes_px
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.reconstruct import reconstruct
from gof.reconstruct.ablations import Ablation
from gof.reconstruct.methods import MethodName, SceneName
from gof.reconstruct.optical_flow import FlowName
from gof.reconstruct.settings import Until


@dataclass
class ReconstructConfig:
    """Three videos -> transient flame Gaussians: result.ply and result.npz.

    Stages: motion (masks, optical flow), flow field (hull, tomography, 3D velocity), seeds, optimisation. The
    optimisation changes where, when, how large and how bright the Gaussians are and how they move, and slightly the
    plates behind them (OUT/plates). Held-out frames are read for scores only.

    OUT/stages has pictures of every stage, OUT/costs.json the costs, OUT/curve.json the scores on held-out pictures
    along the way. `gof view OUT` shows the flame while it is being optimised.

    Examples:
      gof reconstruct data/fire
      gof reconstruct data/fire --preset standard --out out/fire_standard
      gof reconstruct data/takes/1 data/takes/2 --out out/takes      out/takes/1 and out/takes/2
    """

    FIRST: ClassVar = ("out", "preset", "steps", "gaussians", "max_size", "scene", "method", "until")

    datasets: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="DATASET ...")]]
    """Dataset folder (holds dataset.json), or several, which are reconstructed one after the other."""
    out: Path | None = None
    """Folder for the result; a half-finished reconstruction there is resumed. Default: beside the dataset,
    DATASET_flame. Several datasets have folders of their names in it."""
    preset: Preset = "preview"
    """Amount of work: sets --steps, --gaussians, --voxels and --max-size, which can also be set one by one. A clip of
    more than 50 frames gets more steps and Gaussians."""
    steps: int | None = None
    """Optimisation steps, one training picture each."""
    gaussians: int | None = None
    """Number of Gaussians in all frames together."""
    voxels: int | None = None
    """Voxels along the longest side of the flame's box: resolution of the light, and a bound of the Gaussians' size.
    The gas' velocity is always computed on 72, the resolution at which the flow prior was trained."""
    max_size: Pixels | None = None
    """Pictures with a longer side are shrunk to it."""
    method: MethodName = "gof"
    """Our choices, or the paper's wherever they differ (see gof.reconstruct.methods.METHODS). With `paper` three
    things may still differ from the paper: the optical flow (give --flow memfof), the plates (`gof ingest --plates
    minimum`), and an exposure per camera, which is missing here."""
    scene: SceneName | None = None
    """Background of the flame: `plates`, a picture without fire per camera (fast; the flame is in front of everything),
    or `gaussians`, the still scene in 3D (can hide the flame, can be seen from any side, is part of the result).
    Default: plates, with --method paper gaussians."""
    flow: FlowName = "dis"
    """Optical flow of the pictures: OpenCV's DIS, DeepFlow or TV-L1, or MEMFOF with --flow-weights."""
    flow_weights: Path | None = None
    """Folder with config.json and model.safetensors of a MEMFOF checkpoint; never downloaded."""
    flow_prior: bool = True
    """Use the apparent motion as the gas' velocity, as the paper does. By default a prior trained on simulated flames
    converts apparent motion to gas velocity and its uncertainty."""
    until: Until = "result"
    """Stop after this stage, to look at its pictures; the command without --until continues from there."""
    ablation: Ablation = "none"
    """Leave a part of the method out, as in the paper's ablations (see gof.reconstruct.ablations)."""
    seed: int = 0
    """Random seed of the seeding and of the order of pictures."""
    anyway: bool = False
    """Go on even if cameras, clocks, plates or this machine's memory look impossible."""


def main(argv: list[str]) -> int:
    """`gof reconstruct DATASET ... [--out DIR] [--json FILE]`; see --help."""
    config = read_options(ReconstructConfig, "reconstruct", argv)
    if config.flow_weights is not None and config.flow != "memfof":
        raise GofError(f"--flow-weights are those of --flow memfof, not of {config.flow}; leave them out")
    place = folder_of_each(config.datasets, config.out)
    datasets = {folder: Dataset.open(folder) for folder in config.datasets}  # all of them before hours of work
    return run_each(
        config.datasets,
        lambda folder: reconstruct_one(datasets[folder], place(folder) or next_to(folder, "_flame"), config),
    )


def reconstruct_one(dataset: Dataset, out: Path, config: ReconstructConfig) -> dict:
    """Reconstruct a dataset into a folder, print its scores, and return the figures of --json."""
    result = reconstruct(
        dataset,
        out,
        config.preset,
        steps=config.steps,
        gaussians=config.gaussians,
        voxels=config.voxels,
        max_size=config.max_size,
        until=config.until,
        flow_weights=config.flow_weights,
        anyway=config.anyway,
        overwrite=may_overwrite(),
        method=config.method,
        scene=config.scene,
        flow=config.flow,
        flow_prior=config.flow_prior,
        ablation=config.ablation,
        seed=config.seed,
    )
    if result is None:
        pictures = out / "stages"
        print(f"stopped after {config.until}: pictures in {pictures}; run the same command without --until to continue")
        return {"stopped_after": config.until, "pictures": str(pictures)}

    scores = result.held_out.scores
    held_out = {"step": result.held_out.step, "seconds": result.held_out.seconds} | asdict(scores)
    for stage in result.stages:
        print(f"{stage.name:<12} {stage.seconds:8.1f} s {stage.peak_mb:8.0f} MB")
    if scores.psnr_flame is not None:
        at, full = in_words(scores.sizes_px), in_words(sizes_px(dataset.cameras))
        print(f"held-out pictures at {at}, flame only: {scores.psnr_flame:.2f} dB, SSIM {scores.ssim_flame:.3f}")
        if at != full:
            print(f"'gof evaluate' scores at the dataset's {full}, where the same result has fewer dB")
    if not dataset.test_frames:
        print("the dataset holds no frame out, so there are no scores of pictures")
    print(f"{result.count} Gaussians -> {result.path}")
    return {
        "result": str(result.path),
        "gaussians": result.count,
        "stages": [asdict(stage) for stage in result.stages],
        "held_out": {name: value for name, value in held_out.items() if value is not None},
    }
