"""How near tomography of a few views comes to the true light, voxel by voxel, and what each of its choices is worth.

    python -m gof_benchmark.evidence.tomography DATASET...

Takes about half a minute a dataset.

Datasets with grids/flame.zarr. A handful of frames of each; no Gaussian is fitted. Columns: cosine and relative L2 of
emission per voxel, extent along the middle camera's view over extent across it (result / truth), the share of light
where the truth has less than a hundredth of its brightest, and dB of the flame, in pixels of a voxel, from cameras all
around that were not given (nan: there are none). Light that a burner's rim hides is in the first four, and in no
picture. Choices were made on dev fires.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import tyro
from scipy.ndimage import gaussian_filter, map_coordinates

from gof.core.cameras import Camera
from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.description import Splits
from gof.dataset import Dataset
from gof.evaluate.emission import FlameGrid
from gof.evaluate.image import psnr
from gof.evaluate.light import DARK
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import Observation, observe
from gof.reconstruct.shrink import shrink
from gof.reconstruct.tomography import TURNS, find_emission
from gof.reconstruct.unseen import FlameEmission, imagine_views, unsaturated_light
from gof.reconstruct.voxels import FlameVoxels, carve

LONGEST_SIDE, VOXELS, FRAMES = 320, 108, 4  # voxels: of the light at `preview`
PER_FRAME = ("frames", "time_s", "image", "intensity", "mask", "allowed", "flow", "delivered")  # of an observation
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
    print("| choice | dataset | cosine | relative L2 | smear | outside | around, dB |\n|---|---|---|---|---|---|---|")
    for label, find in CHOICES.items():
        rows = []
        for folder, case in zip(options.datasets, cases, strict=True):
            rows.append(score(case, find))
            print(f"| {label} | {folder.name} | {in_words(rows[-1])} |", flush=True)
        print(f"| **{label}** | mean | {in_words(np.mean(rows, 0))} |", flush=True)


CHOICES: dict[str, Find] = {
    "even start": partial(find_emission, rounded=False),
    "round start": find_emission,
    **{f"turned {n} times": partial(find_emission, turns=n) for n in (1, TURNS, 2 * TURNS)},
    **{f"turned {TURNS} times, tails below {t}": partial(find_emission, turns=TURNS, tail=t) for t in (0.0, 0.15, 0.5)},
    **{f"turned {TURNS} times, {n} iterations": partial(find_emission, turns=TURNS, iterations=n) for n in (6, 24)},
}


class TomographyCase(NamedTuple):
    """Some frames of a dataset.

    Attributes:
        observation: of these frames alone.
        light: (F, C, H, W).   truth: (F, V) emission.   level: (2,) the middle camera's view, of length 1.
        around: cameras that were not given, in pixels of about a voxel.   seen: what they saw of these frames.
    """

    observation: Observation
    voxels: FlameVoxels
    light: np.ndarray
    truth: np.ndarray
    level: np.ndarray
    around: list[Camera]
    seen: list[PictureAround]


class PictureAround(NamedTuple):
    """A frame's picture by camera `camera` of those around: linear light of (h * w, 3) with fire and without, mask."""

    frame: int
    camera: int
    picture: np.ndarray
    plate: np.ndarray
    mask: np.ndarray


def read_case(folder: Path) -> TomographyCase:
    """Read some of a dataset's frames, held-out ones too, and its true light at the voxels of its hull."""
    dataset = Dataset.open(folder)
    every = Splits(tuple(range(len(dataset.times_s))), ())  # cameras around took held-out frames
    dataset = replace(dataset, description=replace(dataset.description, splits=every))
    observation = observe(shrink(dataset, LONGEST_SIDE), OURS, lambda a, b: np.zeros((*a.shape[:2], 2), np.float32))
    voxels = carve(observation.cameras, observation.mask, VOXELS, blocked=observation.blocked)
    grid = FlameGrid(folder / "grids" / "flame.zarr")
    chosen = np.unique(np.linspace(0, len(observation.frames) - 1, FRAMES).round().astype(int))
    view = dataset.around_view()
    if view:
        chosen = np.flatnonzero(np.isin(observation.frames, view.frames(0)))
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
    part = replace(
        observation,
        **{name: getattr(observation, name)[chosen] for name in PER_FRAME},
        camera_time_s=observation.camera_time_s[:, chosen],
    )
    around, seen = see_around(view, part, voxels) if view else ([], [])
    return TomographyCase(
        part, voxels, unsaturated_light(part), np.array(truths), level / np.linalg.norm(level), around, seen
    )


def see_around(
    view: Dataset, observation: Observation, voxels: FlameVoxels
) -> tuple[list[Camera], list[PictureAround]]:
    """Return the cameras around with pixels of about a voxel, and their pictures of an observation's frames."""
    middle = voxels.center.mean(0)
    pixels = [voxels.voxel_size * camera.K[0, 0] / camera.project(middle[None])[1][0] for camera in view.cameras]
    size = [max(round(n / np.median(pixels)), 1) for n in (view.cameras[0].width, view.cameras[0].height)]

    def reduce(picture: np.ndarray) -> np.ndarray:
        small = cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA)
        return small.reshape(size[0] * size[1], -1).squeeze()

    seen = [
        PictureAround(
            int(np.flatnonzero(observation.frames == frame)[0]),
            c,
            reduce(srgb_to_linear(view.image(c, frame))),
            reduce(srgb_to_linear(view.static(c))),
            reduce(view.mask(c, frame)) > 0.5,
        )
        for c in range(len(view.cameras))
        for frame in view.frames(c)
        if frame in observation.frames
    ]
    return [camera.scaled(*size) for camera in view.cameras], seen


def score_around(case: TomographyCase, emission: np.ndarray) -> float:
    """Return the mean PSNR (dB) of the flame from the cameras around; nan without any."""
    views = imagine_views(FlameEmission(case.voxels, emission), case.observation, case.around) if case.seen else None
    if views is None:
        return float("nan")
    decibels = []
    for frame, camera, picture, plate, mask in case.seen:
        (row,) = np.flatnonzero(views.frames == frame)
        drawn = plate + views.view([row], camera).light.T
        drawn, picture = (linear_to_srgb(np.clip(x, 0, 1))[None, mask] for x in (drawn, picture))
        decibels.append(psnr(drawn, picture))
    return float(np.mean(decibels))


def score(case: TomographyCase, find: Find) -> np.ndarray:
    """Return (5,): means over frames of cosine, relative L2, smear and share outside; dB around."""
    voxels, level = case.voxels, case.level
    along, across = voxels.center[:, :2] @ level, voxels.center[:, :2] @ (level[1], -level[0])

    def stretch(weight: np.ndarray) -> float:
        widths = [
            np.sqrt(np.average((x - np.average(x, weights=weight)) ** 2, weights=weight)) for x in (along, across)
        ]
        return widths[0] / widths[1]

    rows = []
    emission = np.stack([find(voxels, *pair) for pair in zip(case.light, case.observation.mask, strict=True)])
    for found, truth in zip(emission, case.truth, strict=True):
        found, true = found / found.sum(), truth / truth.sum()
        rows.append(
            [
                found @ true / np.sqrt(found @ found * (true @ true)),
                np.linalg.norm(found - true) / np.linalg.norm(true),
                stretch(found) / stretch(true),
                found[true < DARK * true.max()].sum(),
            ]
        )
    return np.append(np.mean(rows, 0), score_around(case, emission))


def in_words(row: np.ndarray) -> str:
    """Return a row's figures as cells of a table."""
    return f"{row[0]:.3f} | {row[1]:.3f} | {row[2]:.2f} | {100 * row[3]:.1f} % | {row[4]:.2f}"


if __name__ == "__main__":
    main()
