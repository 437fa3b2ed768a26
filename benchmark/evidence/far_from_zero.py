"""Does a fire lose anything where its world and clock lie far from zero? The same dataset as it is and moved; a table.

    python -m gof_benchmark.evidence.far_from_zero DATASET --out out/far [--iterations N] [--gaussians N]

Moved is everything that has a place or a time: cameras, frames' times, the true velocity and the grids. Pictures are
the same files. Both are reconstructed and scored from files, as a user does; the third row reads the moved one's places
and times as a program does that keeps them in float32 as they stand, without a datum.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from gof.core.datum import Datum
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import Effort
from gof.reconstruct.settings import ReconstructionSettings
from gof_benchmark.evidence.choices import SMALL
from tests.moved_dataset import moved_copy

UTM_AND_UNIX = Datum((5e5, 5e6, 100.0), 1.7e9)


@dataclass(frozen=True)
class FarFromZero:
    """Reconstruct a dataset as it is and moved to UTM coordinates and Unix time. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """With true velocity, as `gof generate` writes it."""
    out: Path = Path("out/far")
    """Folder for the copy and the reconstructions; finished ones are kept."""
    effort: tyro.conf.OmitArgPrefixes[Effort] = SMALL
    """For both reconstructions."""
    seed: int = 0


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(FarFromZero, prog="python -m gof_benchmark.evidence.far_from_zero", args=argv)
    near, far = config.dataset, config.out / "moved"
    if not (far / "dataset.json").is_file():
        moved_copy(near, far, UTM_AND_UNIX)
    print("| the fire | L2 | CosSim | PSNR flame | SSIM flame |")
    print("|---|---|---|---|---|")
    _row("as it is", near, config.out / "as_it_is", config)
    _row("moved", far, config.out / "moved_out", config)
    dataset, gaussians = Dataset.open(far), TransientGaussians.load(config.out / "moved_out" / "result.npz")
    rounded = gaussians.measured_from(Datum()).measured_from(dataset.datum)  # once to float32 as it stands, and back
    _print("moved, without a datum", rounded, dataset)


def _row(name: str, folder: Path, out: Path, config: FarFromZero) -> None:
    dataset = Dataset.open(folder)
    made = reconstruct(dataset, ReconstructionSettings.of(dataset, config.effort, seed=config.seed), out)
    _print(name, TransientGaussians.load(made.path), dataset)


def _print(name: str, gaussians: TransientGaussians, dataset: Dataset) -> None:
    scores = evaluate(gaussians, dataset)
    velocity = scores.dve
    print(
        f"| {name} | {_in_words(velocity.l2)} | {_in_words(velocity.cos_sim)} | {_in_words(scores.psnr_flame)} | "
        f"{_in_words(scores.ssim_flame)} |",
        flush=True,
    )


def _in_words(figure: float | None) -> str:
    return "none" if figure is None else f"{figure:.4g}"


if __name__ == "__main__":
    main()
