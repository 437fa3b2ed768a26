"""What exact frame times are worth to a reconstruction: the same pictures, with clocks believed more and more wrongly.

    python -m gof_benchmark.evidence.no_sync DATASET --out out/no_sync [--errors 0 0.5 1 2 4] [--json FILE]

DATASET is generated with the effect `clock`, so that its cameras have times of their own and they are known. Error 0 believes
them; 1 rounds them to the nearest frame, which is all that can be known without a board; e makes e times that mistake.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.commands.evaluate import evaluate
from gof.commands.reconstruct import ReconstructConfig, reconstruct
from gof.dataset import Dataset
from gof.errors import GofError
from gof.io.files import read_json, write_json


def mistakes(dataset: Dataset) -> np.ndarray:
    """(C, T) s: what rounding to the nearest frame of the dataset's clock adds to the times of each camera's frames.

    Raises:
        GofError: no camera has times of its own.
    """
    own = np.stack([dataset.camera_times_s(c) for c in range(len(dataset.cameras))]) - dataset.times_s
    if not own.any():
        raise GofError(f"{dataset.path}: all cameras keep the dataset's clock; generate it with the effect 'clock'")
    return np.rint(own / dataset.frame_time_s) * dataset.frame_time_s - own


def believing(dataset: Dataset, error: float) -> Dataset:
    """The dataset with times wrong by `error` times the mistake of rounding."""
    wrong = {
        camera.name: dataset.camera_times_s(c) + error * mistake
        for c, (camera, mistake) in enumerate(zip(dataset.cameras, mistakes(dataset), strict=True))
    }
    entries = [e | {"time_s": wrong[e["name"]].tolist()} if e["name"] in wrong else e for e in dataset.meta["cameras"]]
    return replace(dataset, meta=dataset.meta | {"cameras": entries})


def run_one(dataset: Dataset, error: float, config: NoSyncStudy) -> dict[str, Any]:
    """Reconstruct with these times and score against the true ones; kept when it is there already."""
    folder = config.out / f"error_{error:g}_seed_{config.seed}"
    if (folder / "scores.json").exists():
        return read_json(folder / "scores.json")
    wrong, pictures = believing(dataset, error), folder / "dataset"
    shutil.copytree(
        dataset.path, pictures, ignore=shutil.ignore_patterns(".*", "*.zarr", "*.blend"), dirs_exist_ok=True
    )
    write_json(pictures / "dataset.json", wrong.meta)
    result = reconstruct(
        ReconstructConfig(
            pictures,
            folder,
            gaussians=config.gaussians,
            iterations=config.iterations,
            voxels=config.voxels,
            longest_side=config.longest_side,
            seed=config.seed,
        )
    )
    true = evaluate(result, dataset)
    shifts = error * mistakes(dataset).mean(1) / dataset.frame_time_s
    scores = {
        "error": error,
        "shift_frames": shifts.round(3).tolist(),
        "l2": true["dve"]["l2"],
        "cos_sim": true["dve"]["cos_sim"],
        "psnr_flame": true["psnr_flame"],
        "psnr": true["psnr"],
        "psnr_flame_believed": evaluate(result, replace(wrong, meta=wrong.meta | {"velocity": None}))["psnr_flame"],
    }
    write_json(folder / "scores.json", scores)
    shutil.rmtree(pictures)
    return scores


@dataclass
class NoSyncStudy:
    """Reconstruct one dataset with its cameras' true times and with wrong ones. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """Dataset folder with true velocity, generated with the effect `clock`."""
    out: Path = Path("out/no_sync")
    """Folder for the reconstructions; finished ones are kept."""
    errors: tuple[float, ...] = (0, 0.5, 1, 2, 4)
    """Mistakes, in units of what rounding to the nearest frame does."""
    gaussians: int = 15_000
    iterations: int = 800
    voxels: int = 72
    longest_side: int = 160
    seed: int = 0
    json: Path | None = None
    """Also write the figures to this file."""


def main() -> None:
    """Print the table."""
    config = tyro.cli(NoSyncStudy)
    dataset = Dataset.open(config.dataset)
    print("| error | cameras off by (frames) | L2 | CosSim | PSNR flame at true times | at believed times | PSNR |")
    print("|---|---|---|---|---|---|---|")
    rows = []
    for error in config.errors:
        row = run_one(dataset, error, config)
        rows.append(row)
        print(
            f"| {error:g} | {', '.join(f'{s:+.2f}' for s in row['shift_frames'])} | {row['l2']:.3f} | {row['cos_sim']:.3f} | "
            f"{row['psnr_flame']:.2f} | {row['psnr_flame_believed']:.2f} | {row['psnr']:.2f} |",
            flush=True,
        )
    if config.json:
        write_json(config.json, rows)


if __name__ == "__main__":
    main()
