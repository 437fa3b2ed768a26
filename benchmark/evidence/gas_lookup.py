"""The worth of asking the flow field for the gas again, where the pictures have brought each Gaussian.

    python -m gof_benchmark.evidence.gas_lookup DATASET RESULT [DATASET RESULT ...]

DATASET has true velocity, RESULT is a folder of `gof reconstruct` without density control. Per pair DVE
(`gof.evaluate`) of three results that differ in nothing but what they say of the gas: what the seeds were told, what
the field says where and when each Gaussian is brightest, and its mean along the Gaussian's life, which is the method
(`gof.reconstruct.gas`). "moved" is how far Gaussians ended from their seeds: median, in voxels and in frame times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import dve
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.gas import gas_at, told_of_gas
from gof.reconstruct.seen import see_again

HEADER = """\
| result | moved | as the seeds were told: L2, CosSim, speed | where it ends | along its life |
|---|---|---|---|---|"""


@dataclass(frozen=True)
class GasLookup:
    """The gas as the seeds were told, where Gaussians end, and along their lives."""

    pairs: tyro.conf.Positional[tuple[Path, ...]]
    """Dataset, result, dataset, result, ..."""


def told(result: TransientGaussians, seeds: TransientGaussians, field: FlowField) -> Iterator[TransientGaussians]:
    """Yield the three, in the table's order."""
    yield replace(result, gas_velocity=seeds.gas_velocity)
    velocity, _ = gas_at(field, result.position, result.t_mu)
    yield replace(result, gas_velocity=np.where(np.isfinite(velocity), velocity, seeds.gas_velocity))
    yield told_of_gas(replace(result, gas_velocity=seeds.gas_velocity), field)


def score(gaussians: TransientGaussians, dataset: Dataset) -> str:
    """Means over the frames."""
    times = dataset.times_s
    found = [dve(gaussians, dataset.velocity.at(float(t)), float(t)) for t in times]
    return ", ".join(f"{np.mean([getattr(s, name) for s in found]):.3f}" for name in ("l2", "cos_sim", "speed_ratio"))


def row(path: Path, folder: Path) -> str:
    """Return a line of the table. Raises GofError: the result has other Gaussians than its seeds."""
    dataset = Dataset.open(path)
    field = see_again(dataset, folder).field
    result, seeds = (TransientGaussians.load(folder / name) for name in ("result.npz", "seeds.npz"))
    if len(result) != len(seeds):
        raise GofError(f"{folder}: {len(result)} Gaussians of {len(seeds)} seeds; density control, or a still scene")
    way = np.linalg.norm(result.position - seeds.position, axis=1) / field.voxels.voxel_size
    wait = np.abs(result.t_mu - seeds.t_mu) / dataset.frame_time_s
    cells = [score(gaussians, dataset) for gaussians in told(result, seeds, field)]
    return f"| {folder} | {np.median(way):.2f}, {np.median(wait):.2f} | {' | '.join(cells)} |"


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(GasLookup, prog="python -m gof_benchmark.evidence.gas_lookup", args=argv)
    if len(config.pairs) % 2 or not config.pairs:
        raise SystemExit("name pairs: DATASET RESULT [DATASET RESULT ...]")
    print(HEADER)
    for path, folder in zip(config.pairs[::2], config.pairs[1::2], strict=True):
        print(row(path, folder), flush=True)


if __name__ == "__main__":
    main()
