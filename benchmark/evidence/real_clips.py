"""How well real flames are drawn: ours and the paper's choices on held-out frames, beside what 2D alone would do.

    python -m gof_benchmark.evidence.real_clips DATASET... --longest-side 854 --voxels 96 [--out out/real]

Takes about 20 min a clip and method.

DATASETs are of `gof ingest`, best after `gof capture annotate` (the board's LEDs then do not count). The trivial
baselines draw a held-out frame by the two frames of *the same camera* around it: their mean, and each carried half way
along the optical flow from one to the other. No method may do that for a view that was not filmed, but it says what
compression and noise leave to be had: a scene in 3D that does better has seen through three cameras what one camera
lost.

Every row is the mean over a clip's held-out pictures at full size, as a result is made to be seen, whatever the size it
was fitted at. Below them stand ours beside the strongest baseline, and means over the clips. The flame is the estimated
mask of `gof.footage.flame_mask`, "moves" the pixels that the authors' figures count (`gof.evaluate.authors_figures`).
Reconstructions are kept in OUT/CLIP/METHOD_SEED and go on where they were, so it may be stopped and started as one
likes.

`--clocks` says what is believed of the cameras' times: "read", what the dataset says; "frames", that pictures of one
number are of one moment, as in videos that somebody aligned; "snapshots", that all lines of a picture are of the moment
of its middle one; "neither". Held-out pictures are then drawn as they are believed to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from gof.core.costs import StageLog
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate import psnr, ssim
from gof.evaluate.authors_figures import moving
from gof.evaluate.between import between_neighbours
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.methods import MethodName
from gof.reconstruct.optical_flow import dis
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import PRESETS, Effort
from gof.reconstruct.settings import ReconstructionSettings
from gof.render import render

Picture = np.ndarray  # (H, W, 3) display values in [0, 1]
Draw = Callable[[int, int], Picture]  # of a camera and a frame
Clocks = Literal["read", "frames", "snapshots", "neither"]


@dataclass(frozen=True)
class RealClips:
    """Reconstruct real clips by ours and by the paper's choices. Prints a table."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `gof ingest`."""
    out: Path = Path("out/real")
    """Folder for the reconstructions; finished ones are kept."""
    methods: tuple[MethodName, ...] = ("gof", "paper")
    """For `gof reconstruct --method`."""
    effort: tyro.conf.OmitArgPrefixes[Effort] = PRESETS["standard"]
    """For every reconstruction."""
    clocks: tuple[Clocks, ...] = ("read",)
    """Belief about the cameras' times."""
    seeds: int = 1
    """Runs of each."""


COLUMNS = ("PSNR flame", "SSIM flame", "PSNR of what moves", "PSNR", "SSIM")


def figures(dataset: Dataset, draw: Draw) -> np.ndarray:
    """Return (5,) means of `COLUMNS` over the held-out pictures that have a frame before and after; NaN: defined in
    none."""
    rows = []
    for c in range(len(dataset.cameras)):
        board, plate = dataset.board_weight(c), dataset.static(c)
        counts = np.ones(plate.shape[:2]) if board is None else board
        for k in dataset.test_frames:
            if not 0 < k < len(dataset.times_s) - 1:
                continue
            truth, drawn = dataset.image(c, k), draw(c, k)
            mask = dataset.mask(c, k)
            flame = counts * (flame_mask(truth, plate) if mask is None else mask)
            moves = moving(truth, dataset.image(c, k + 1), dis) & (counts > 0.5)
            rows.append(
                [
                    psnr(drawn, truth, flame),
                    ssim(drawn, truth, flame),
                    psnr(drawn, truth, moves),
                    psnr(drawn, truth, counts),
                    ssim(drawn, truth, counts),
                ]
            )
    found = np.array(rows, float)  # None becomes NaN
    return np.array([column[np.isfinite(column)].mean() if np.isfinite(column).any() else np.nan for column in found.T])


def mean_of_neighbours(dataset: Dataset) -> Draw:
    """Return a function that gives a frame as the mean of the two around it."""
    return lambda c, k: (dataset.image(c, k - 1) + dataset.image(c, k + 1)) / 2


def carried_along_flow(dataset: Dataset) -> Draw:
    """Return a function that carries both neighbours half way along the flow from one to the other, and takes their
    mean."""

    def draw(c: int, k: int) -> Picture:
        picture = between_neighbours(dataset, c, k, dis)
        assert picture is not None, "asked only of held-out pictures between two others"
        return picture

    return draw


def of_result(dataset: Dataset, folder: Path) -> Draw:
    """Return a drawer of the result of `gof reconstruct` in a folder: over its plates, or with its own still scene."""
    gaussians = TransientGaussians.load(folder / "result.npz")
    cameras = range(len(dataset.cameras))
    plates = [background(dataset, c, folder) for c in cameras] if gaussians.dynamic.all() else [None for _ in cameras]

    def draw(c: int, k: int) -> Picture:
        time_s = float(dataset.camera_times_s(c)[k])
        return np.clip(render(gaussians, dataset.cameras[c], time_s, background=plates[c])["color"], 0, 1)

    return draw


def believing(dataset: Dataset, clocks: Clocks) -> Dataset:
    """Return the dataset with other times of its cameras' pictures and lines."""
    frames, snapshots = clocks in ("frames", "neither"), clocks in ("snapshots", "neither")
    cameras, times = [], {}
    for c, camera in enumerate(dataset.cameras):
        lines = camera.width if camera.readout in ("left", "right") else camera.height
        middle_s = 0.5 * camera.row_time_s * lines if snapshots else 0.0
        own = dataset.description.time_s if frames else dataset.camera_times_s(c) + dataset.datum.time_s
        times[camera.name] = tuple((np.asarray(own) + middle_s).tolist())
        cameras.append(replace(camera, row_time_s=0.0) if snapshots else camera)
    entries = [replace(entry, time_s=times.get(entry.name, entry.time_s)) for entry in dataset.description.cameras]
    return replace(dataset, cameras=cameras, description=replace(dataset.description, cameras=tuple(entries)))


@dataclass(frozen=True)
class Row:
    """A clip drawn in one way.

    Attributes:
        means: (5,) means of `COLUMNS`.   spread: standard deviation of the first over seeds, or None.
        seconds, memory_gb: the cost of reconstructing it, or None.
    """

    clip: str
    name: str
    means: np.ndarray
    spread: float | None = None
    seconds: float | None = None
    memory_gb: float | None = None

    def __str__(self) -> str:
        cells = cells_of(self.means)
        cells[0] += self.scatter
        cost = "- | -" if self.seconds is None else f"{self.seconds:.0f} | {self.memory_gb:.1f}"
        return f"| {self.clip} | {self.name} | {' | '.join(cells)} | {cost} |"

    @property
    def scatter(self) -> str:
        """The spread over seeds, in words."""
        return "" if self.spread is None else f" ± {self.spread:.2f}"


def cells_of(means: np.ndarray) -> list[str]:
    """Return (5,) means of `COLUMNS` with the digits that they deserve."""
    digits = (3 if head.startswith("SSIM") else 2 for head in COLUMNS)
    return ["-" if np.isnan(x) else f"{x:.{n}f}" for n, x in zip(digits, means, strict=True)]


CARRIED, OURS = "the same, carried along their flow", "ours"


def rows_of(path: Path, config: RealClips) -> list[Row]:
    """Print and return those of a clip: the trivial baselines first, then every method."""
    dataset = Dataset.open(path)
    trivial_baselines = {
        "the plate alone": lambda c, k: dataset.static(c),
        "mean of the two frames around": mean_of_neighbours(dataset),
        CARRIED: carried_along_flow(dataset),
    }
    rows = []
    for name, draw in trivial_baselines.items():
        rows.append(Row(path.name, name, figures(dataset, draw)))
        print(rows[-1], flush=True)
    for method in config.methods:
        for clocks in config.clocks:
            rows.append(_method_row(path.name, dataset, method, clocks, config))
            print(rows[-1], flush=True)
    return rows


def _method_row(clip: str, full: Dataset, method: MethodName, clocks: Clocks, config: RealClips) -> Row:
    """Reconstruct and score, once for every seed."""
    believed = full if clocks == "read" else believing(full, clocks)
    found, costs = [], []
    for seed in range(config.seeds):
        folder = config.out / clip / "_".join([method, *([] if clocks == "read" else [clocks]), str(seed)])
        settings = ReconstructionSettings.of(believed, config.effort, method=method, seed=seed)
        reconstruct(believed, settings, folder)
        found.append(figures(believed, of_result(believed, folder)))
        costs.append(StageLog(folder / "costs.json").stages())
    name = OURS if method == "gof" else f"`--method {method}`"
    return Row(
        clip,
        name + ("" if clocks == "read" else f", times: {clocks}"),
        np.mean(found, 0),
        spread=float(np.std([f[0] for f in found], ddof=1)) if len(found) > 1 else None,
        seconds=float(np.mean([sum(stage.seconds for stage in run) for run in costs])),
        memory_gb=max(stage.peak_mb for run in costs for stage in run) / 1000,
    )


def print_summary(rows: list[Row]) -> None:
    """Print ours beside the strongest baseline, the better one bold, and means over the clips."""
    ours = [row for row in rows if row.name == OURS]
    carried = {row.clip: row for row in rows if row.name == CARRIED}
    print("\n| clip | ours | frames before and after, by optical flow | minutes, ours |\n|---|---|---|---|")
    for row in ours:
        mine, theirs = round(row.means[0], 2), round(carried[row.clip].means[0], 2)
        cells = [f"**{x:.2f}**" if x == max(mine, theirs) else f"{x:.2f}" for x in (mine, theirs)]
        print(f"| {row.clip} | {cells[0]}{row.scatter} | {cells[1]} | {(row.seconds or 0) / 60:.0f} |")
    print(f"\n| mean of {len(ours)} clips | {' | '.join(COLUMNS)} |\n{'|---' * (len(COLUMNS) + 1)}|")
    for name in dict.fromkeys(row.name for row in rows):
        means = np.mean([row.means for row in rows if row.name == name], 0)
        print(f"| {name} | {' | '.join(cells_of(means))} |")


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(RealClips, prog="python -m gof_benchmark.evidence.real_clips", args=argv)
    print(f"| clip | | {' | '.join(COLUMNS)} | seconds | GB |")
    print("|---" * (len(COLUMNS) + 4) + "|")
    print_summary([row for path in config.datasets for row in rows_of(path, config)])


if __name__ == "__main__":
    main()
