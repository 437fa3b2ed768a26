"""The built-in scenes reconstructed in four ways, ours and the paper's, scored as by `gof evaluate`.

    python -m gof_benchmark.evidence.four_ways WORK [--scenes classroom cloister] [--ways ours paper] [--seeds 3]

Takes about 50 min beside other work.

Makes the datasets first, smaller than `standard`, with few samples a pixel, which the denoiser forgives. The flame's
PSNR for novel views is that of a camera that no method is given; only a scene of Gaussians can be seen from there.
Everything is kept in WORK, and what is finished is not done again. Beside seconds and scores of each way stand the
trivial baselines, which know the truth; below all, the motion of each way beside what the paper publishes.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from gof.core.costs import StageLog
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.scores import Scores
from gof.host.processes import python_command
from gof.reconstruct.curve import Curve
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import PRESETS, Effort
from gof.reconstruct.settings import ReconstructionSettings
from gof.reconstruct.shrink import shrink
from gof_benchmark.scenes import load_scene
from gof_blender.pure import spec as scene_spec

Way = Literal["ours", "ours in Gaussians", "no flow prior", "paper"]
OPTIONS: dict[Way, dict] = {
    "ours": {},
    "ours in Gaussians": {"scene": "gaussians"},
    "no flow prior": {"flow_prior": False},
    "paper": {"method": "paper"},
}
COMMANDS: dict[Way, str] = {
    "ours": "ours",
    "ours in Gaussians": "ours, `--scene gaussians`",
    "no flow prior": "`--no-flow-prior`",
    "paper": "`--method paper`",
}
COLUMNS = ("L2", "CosSim", "fluctuation L2, CosSim", "speed / true", "PSNR flame", "SSIM flame", "PSNR")
COLUMNS += ("PSNR flame, novel", "s")
DIGITS = (3, 3, 2, 2, 2, 2, 3, 2, 2, 0)  # of the columns' figures
FRAMES, CELLS, PERCENTAGE = 36, 64, 25
SAMPLES = {"classroom": 6}  # a room lit through its windows; the others 2
PUBLISHED = "0.825 ± 0.058 | 0.744 ± 0.032"  # the paper's table of motion, mean of its three scenes: L2, CosSim


@dataclass(frozen=True)
class FourWays:
    """Make the built-in scenes, reconstruct each in four ways, and score them."""

    work: tyro.conf.Positional[Path]
    """Folder for datasets and reconstructions."""
    scenes: tuple[str, ...] = ("classroom", "workshop", "cloister")
    """Built-in scenes."""
    ways: tuple[Way, ...] = tuple(OPTIONS)
    """For the reconstruction."""
    effort: tyro.conf.OmitArgPrefixes[Effort] = PRESETS["preview"]
    """For every reconstruction."""
    seeds: int = 1
    """Runs of each way; the table shows their mean, and the spread of L2."""


def make_dataset(scene: str, work: Path) -> Path:
    """Generate the scene's dataset, and return its folder."""
    spec = load_scene(scene)
    spec = replace(
        spec,
        clip=replace(spec.clip, frames=FRAMES),
        domain=replace(spec.domain, resolution=CELLS),
        render=replace(spec.render, percentage=PERCENTAGE, samples=SAMPLES.get(scene, 2), plate_samples=32),
    )
    file, folder = work / f"{scene}.json", work / scene
    scene_spec.save(spec, file)
    command = python_command("-m", "gof", "generate", str(file), "--out", str(folder))
    subprocess.run(command, check=True, stdout=sys.stderr)
    return folder


def scored(path: Path, way: Way, seed: int, config: FourWays) -> tuple[Scores, list[float]]:
    """Reconstruct and score; scores, and the columns as numbers, NaN where there is none."""
    full = Dataset.open(path)
    folder = config.work / "results" / f"{path.name}_{way.replace(' ', '_')}_{seed}"
    settings = ReconstructionSettings.of(full, config.effort, seed=seed, **OPTIONS[way])
    scores = evaluate(reconstruct(full, settings, folder).path, shrink(full, config.effort.longest_side))
    dve, curve = scores.dve, Curve.read(folder).points[-1].scores
    seconds = sum(stage.seconds for stage in StageLog(folder / "costs.json").stages())
    figures = [dve.l2, dve.cos_sim, dve.fluctuation.l2, dve.fluctuation.cos_sim, dve.speed_ratio]
    figures += [scores.psnr_flame, scores.ssim_flame, scores.psnr, curve.psnr_flame_novel, seconds]
    return scores, [np.nan if x is None else float(x) for x in figures]


def line(scene: str, name: str, runs: np.ndarray) -> str:
    """Return a row of the table: the means of (runs, figures), empty where there is none, and the spread of the
    first."""
    means = [("" if np.isnan(x) else f"{x:.{digits}f}") for x, digits in zip(runs.mean(0), DIGITS, strict=True)]
    spread = f" ± {runs[:, 0].std(ddof=1):.3f}" if len(runs) > 1 else ""
    cells = [means[0] + spread, means[1], ", ".join(means[2:4]), *means[4:]]
    return f"| {scene} | {name} | {' | '.join(cells)} |"


def trivial_baselines(scene: str, scores: Scores) -> str:
    """Return the row of what knows the truth, on the Gaussians of ours."""
    both = [scores.trivial_baselines[name] for name in ("constant", "height_mean")]
    cells = [
        "; ".join(f"{getattr(trivial_baseline, score):.3f}" for trivial_baseline in both) for score in ("l2", "cos_sim")
    ]
    return f"| {scene} | trivial baselines: constant; mean per height | {' | '.join(cells)} |" + " |" * (
        len(COLUMNS) - 2
    )


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(FourWays, prog="python -m gof_benchmark.evidence.four_ways", args=argv)
    config.work.mkdir(parents=True, exist_ok=True)
    print(f"| scene | | {' | '.join(COLUMNS)} |")
    print("|---" * (len(COLUMNS) + 2) + "|")
    motions: dict[str, list[np.ndarray]] = {}
    for scene in config.scenes:
        path, first = make_dataset(scene, config.work), None
        for way in config.ways:
            runs = [scored(path, way, seed, config) for seed in range(config.seeds)]
            first = first or runs[0][0]
            table = np.array([figures for _, figures in runs])
            print(line(scene, COMMANDS[way], table), flush=True)
            motions.setdefault(f"{COMMANDS[way]} here", []).append(table[:, :2].mean(0))
        print(trivial_baselines(scene, first), flush=True)
        for name, words in (("constant", "constant"), ("height_mean", "mean per height")):
            baseline = first.trivial_baselines[name]
            motions.setdefault(words, []).append(np.array([baseline.l2, baseline.cos_sim]))
    print(f"\n| {', '.join(config.scenes)} | L2 | CosSim |\n|---|---|---|")
    print(f"| the paper, mean of its three scenes | {PUBLISHED} |")
    for name, scenes in motions.items():
        l2, cosine = (", ".join(f"{x:.3f}" for x in column) for column in np.transpose(scenes))
        print(f"| {name} | {l2} | {cosine} |")


if __name__ == "__main__":
    main()
