"""How near tomography of a few views comes to the true light, voxel by voxel, and what each of its choices is worth.

    python -m gof_benchmark.evidence.tomography DATASET...

Datasets with grids/flame.zarr. A handful of frames of each; no Gaussian is fitted. Columns: cosine and relative L2 of
emission per voxel, extent along the middle camera's view over extent across it (result / truth), and the share of light
where the truth has less than a hundredth of its brightest. Choices were made on dev fires.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from scipy.ndimage import gaussian_filter, map_coordinates

from gof.dataset import Dataset
from gof.evaluate.emission import FlameGrid
from gof.evaluate.light import DARK
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import observe
from gof.reconstruct.shrink import shrink
from gof.reconstruct.tomography import find_compact_emission, find_emission
from gof.reconstruct.unseen import unsaturated_light
from gof.reconstruct.voxels import FlameVoxels, carve

LONGEST_SIDE, VOXELS, FRAMES = 320, 56, 4
BLUR = 0.4  # of a voxel, std-dev by which the truth is blurred before it is sampled at voxels' centres

Find = Callable[[FlameVoxels, np.ndarray, np.ndarray], np.ndarray]


@dataclass
class TomographyConfig:
    """Compare emission by tomography with the true light. Prints a table."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Dataset folders with true light."""


def main(argv: list[str] | None = None) -> None:
    """Print a row per choice and dataset, and the mean over datasets."""
    options = tyro.cli(TomographyConfig, prog="python -m gof_benchmark.evidence.tomography", args=argv)
    cases = [read_case(folder) for folder in options.datasets]
    print("| choice | dataset | cosine | relative L2 | smear | outside |\n|---|---|---|---|---|---|")
    for label, find in CHOICES.items():
        rows = []
        for folder, case in zip(options.datasets, cases, strict=True):
            rows.append(score(case, find))
            print(f"| {label} | {folder.name} | {in_words(rows[-1])} |", flush=True)
        print(f"| **{label}** | mean | {in_words(np.mean(rows, 0))} |", flush=True)


CHOICES: dict[str, Find] = {
    "plain EM, even start": partial(find_emission, rounded=False),
    "plain EM, round start": find_emission,
    "compact": find_compact_emission,
    "compact, power 1": partial(find_compact_emission, power=1.0),
    "compact, power 1.1": partial(find_compact_emission, power=1.1),
    "compact, power 1.2": partial(find_compact_emission, power=1.2),
    "compact, not smoothed": partial(find_compact_emission, smooth=1e-3),
    "compact, smoothed by 0.75": partial(find_compact_emission, smooth=0.75),
    "compact, start as wide as the views": partial(find_compact_emission, wider=1.0),
    "compact, even start": partial(find_compact_emission, wider=1e3),
}


class Case(NamedTuple):
    """Some frames of a dataset.

    Attributes:
        light: (F, C, H, W).   mask: (F, C, H, W) bool.   truth: (F, V) emission.
        level: (2,) the middle camera's view, of length 1.
    """

    voxels: FlameVoxels
    light: np.ndarray
    mask: np.ndarray
    truth: np.ndarray
    level: np.ndarray


def read_case(folder: Path) -> Case:
    """Read a dataset's frames, and its true light at the voxels of its hull."""
    dataset = Dataset.open(folder)
    observation = observe(shrink(dataset, LONGEST_SIDE), OURS, lambda a, b: np.zeros((*a.shape[:2], 2), np.float32))
    voxels = carve(observation.cameras, observation.mask, VOXELS, blocked=observation.blocked)
    grid = FlameGrid(folder / "grids" / "flame.zarr")
    chosen = np.unique(np.linspace(0, len(observation.frames) - 1, FRAMES).round().astype(int))
    cell = np.linalg.norm(grid.index_to_world[:3, 0])
    to_index = np.linalg.inv(grid.index_to_world)
    places = (voxels.center @ to_index[:3, :3].T + to_index[:3, 3] - 0.5).T
    truths = []
    for f in chosen:
        dense = np.zeros(grid.resolution)
        cells, light = grid.light(grid.frame_at(float(observation.time_s[f])))
        dense[tuple(cells.T)] = light
        blurred = gaussian_filter(dense, BLUR * voxels.voxel_size / cell)
        truths.append(map_coordinates(blurred, places, order=1, mode="constant"))
    level = voxels.forward[len(voxels.forward) // 2, :2]
    light = unsaturated_light(observation)[chosen]
    return Case(voxels, light, observation.mask[chosen], np.array(truths), level / np.linalg.norm(level))


def score(case: Case, find: Find) -> np.ndarray:
    """Return (4,) means over frames: cosine, relative L2, smear, share outside."""
    voxels, lights, masks, truths, level = case
    along, across = voxels.center[:, :2] @ level, voxels.center[:, :2] @ (level[1], -level[0])

    def stretch(weight: np.ndarray) -> float:
        widths = [
            np.sqrt(np.average((x - np.average(x, weights=weight)) ** 2, weights=weight)) for x in (along, across)
        ]
        return widths[0] / widths[1]

    rows = []
    for light, mask, truth in zip(lights, masks, truths, strict=True):
        found, true = find(voxels, light, mask), truth / truth.sum()
        found = found / found.sum()
        rows.append(
            [
                found @ true / np.sqrt(found @ found * (true @ true)),
                np.linalg.norm(found - true) / np.linalg.norm(true),
                stretch(found) / stretch(true),
                found[true < DARK * true.max()].sum(),
            ]
        )
    return np.mean(rows, 0)


def in_words(row: np.ndarray) -> str:
    """Return a row's figures as cells of a table."""
    return f"{row[0]:.3f} | {row[1]:.3f} | {row[2]:.2f} | {100 * row[3]:.1f} %"


if __name__ == "__main__":
    main()
