"""The worth of exact frame times to a reconstruction: the same pictures, with clocks believed more and more wrongly.

    python -m gof_benchmark.evidence.wrong_clocks DATASET [--out out/wrong_clocks] [--errors 0 0.5 1 2 4] [--json FILE]

Takes about 10 min.

DATASET is generated with the effect `clock`, so that its cameras have times of their own and they are known. Error 0
believes them; 1 rounds them to the nearest frame, which is all that can be known without a board; e makes e times that
mistake. The paper's ablation NoSync (`gof study ablations`) is another thing: there every second camera of any dataset
is believed half a frame time late.
"""

from __future__ import annotations

import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import read_json, write_json
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import Effort
from gof.reconstruct.settings import ReconstructionSettings
from gof_benchmark.evidence.choices import SMALL


@dataclass(frozen=True)
class WrongClocks:
    """Reconstruct one dataset with its cameras' true times and with wrong ones. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """Dataset folder with true velocity, generated with the effect `clock`."""
    out: Path = Path("out/wrong_clocks")
    """Folder for the reconstructions; finished ones are kept."""
    errors: tuple[float, ...] = (0, 0.5, 1, 2, 4)
    """Mistakes, in units of what rounding to the nearest frame does."""
    effort: tyro.conf.OmitArgPrefixes[Effort] = SMALL
    """For every reconstruction."""
    seed: int = 0
    json: Path | None = None
    """Also write the figures to this file."""


@dataclass(frozen=True)
class ClockScores:
    """A reconstruction's scores against the true times, and its flame's PSNR at the times it believed."""

    error: float
    shift_frames: list[float]
    l2: float
    cos_sim: float
    psnr_flame: float | None
    psnr: float | None
    psnr_flame_believed: float | None

    def __str__(self) -> str:
        shifts = ", ".join(f"{shift:+.2f}" for shift in self.shift_frames)
        pictures = (self.psnr_flame, self.psnr_flame_believed, self.psnr)
        cells = ["-" if value is None else f"{value:.2f}" for value in pictures]
        return f"| {self.error:g} | {shifts} | {self.l2:.3f} | {self.cos_sim:.3f} | {' | '.join(cells)} |"


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(WrongClocks, prog="python -m gof_benchmark.evidence.wrong_clocks", args=argv)
    dataset = Dataset.open(config.dataset)
    print("| error | cameras off by (frames) | L2 | CosSim | PSNR flame at true times | at believed times | PSNR |")
    print("|---|---|---|---|---|---|---|")
    rows = []
    for error in config.errors:
        rows.append(run_one(dataset, error, config))
        print(rows[-1], flush=True)
    if config.json:
        write_json(config.json, [asdict(row) for row in rows])


def mistakes(dataset: Dataset) -> np.ndarray:
    """Return (C, T) s: what rounding to the nearest frame of the dataset's clock adds to the times of each camera's
    frames.

    Raises:
        GofError: no camera has times of its own.
    """
    own = np.stack([dataset.camera_times_s(c) for c in range(len(dataset.cameras))]) - dataset.times_s
    if not own.any():
        raise GofError(f"{dataset.path}: all cameras keep the dataset's clock; generate it with the effect 'clock'")
    return np.rint(own / dataset.frame_time_s) * dataset.frame_time_s - own


def believing(dataset: Dataset, error: float) -> Dataset:
    """Return the dataset with times wrong by `error` times the mistake of rounding."""
    wrong = {
        camera.name: dataset.camera_times_s(c) + error * mistake
        for c, (camera, mistake) in enumerate(zip(dataset.cameras, mistakes(dataset), strict=True))
    }
    entries = tuple(
        replace(entry, time_s=tuple(wrong[entry.name].tolist())) if entry.name in wrong else entry
        for entry in dataset.description.cameras
    )
    return replace(dataset, description=replace(dataset.description, cameras=entries))


def run_one(dataset: Dataset, error: float, config: WrongClocks) -> ClockScores:
    """Reconstruct with these times and score against the true ones; kept when it is there already."""
    folder = config.out / f"error_{error:g}_seed_{config.seed}"
    known = folder / "row.json"
    if not known.exists():
        write_json(known, asdict(_reconstruct_and_score(dataset, error, config, folder)))
    return ClockScores(**read_json(known))


def _reconstruct_and_score(dataset: Dataset, error: float, config: WrongClocks, folder: Path) -> ClockScores:
    wrong = believing(dataset, error)
    copy = folder / "dataset"
    left_out = shutil.ignore_patterns(".*", "*.zarr", "*.blend")
    shutil.copytree(dataset.path, copy, ignore=left_out, dirs_exist_ok=True)
    wrong.description.write(copy)
    believed = Dataset.open(copy)
    result = reconstruct(believed, ReconstructionSettings.of(believed, config.effort, seed=config.seed), folder).path
    true = evaluate(result, dataset)
    pictures_alone = replace(wrong, description=replace(wrong.description, velocity=None))
    shifts = error * mistakes(dataset).mean(1) / dataset.frame_time_s
    row = ClockScores(
        error=error,
        shift_frames=shifts.round(3).tolist(),
        l2=true.dve.l2,
        cos_sim=true.dve.cos_sim,
        psnr_flame=true.psnr_flame,
        psnr=true.psnr,
        psnr_flame_believed=evaluate(result, pictures_alone).psnr_flame,
    )
    shutil.rmtree(copy)
    return row


if __name__ == "__main__":
    main()
