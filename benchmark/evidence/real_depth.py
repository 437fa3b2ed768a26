"""Whether filmed flames stand where stereo sees them: the authors' error of depth, and what it is without a flame.

    python -m gof_benchmark.evidence.real_depth DATASET... [--out out/real]

Takes about a minute a clip, after `real_clips`.

OUT is that of `real_clips`, with both methods' results. The maps are those of `gof depth`: stereo between the cameras
at every held-out frame, completed along the picture's edges; the authors take a monocular network's. The pictures show:

    still     the still scene of `--method paper`, without any flame: what the figure gives for nothing
    paper     the result of `--method paper`, flame and still scene
    ours      ours in that same still scene, as `gof background --flame` puts them together
    alone     ours, a flame before nothing

"1/depth" is `gof.evaluate.authors_figures.rmse_disparity`: scale and offset are fitted over the whole picture.
"off" is the median of |z / stereo - 1| over those of the same pixels in which what is drawn is seen, z the mean
distance of the
flame's Gaussians alone (of the still scene's for "still"): nothing is fitted, so it says how far before or behind the
flame stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.authors_figures import drawn_disparity, inside, moving, rmse_disparity
from gof.evaluate.depth import read_depth
from gof.evaluate.image_scores import VISIBLE
from gof.host.terminal import progress_bar
from gof.ingest.depth import write_frame_depths
from gof.reconstruct.optical_flow import dis
from gof.render import render


@dataclass(frozen=True)
class RealDepth:
    """Score the depth of reconstructed real clips. Prints a table."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `gof ingest`."""
    out: Path = Path("out/real")
    """Folder of `real_clips`, with OUT/CLIP/gof_0 and OUT/CLIP/paper_0; the maps go to OUT/CLIP/depth."""


@dataclass(frozen=True)
class ScoredParts:
    """The picture scored under a name: `whole` for inverse depth, `part` of it for the distance of the flame alone."""

    whole: TransientGaussians
    part: TransientGaussians


@dataclass(frozen=True)
class HeldOutView:
    """A camera at a held-out frame: what moves there, (H, W) bool, and the depth, 1/depth that are expected."""

    camera: Camera
    time_s: float
    flame: np.ndarray
    depth: np.ndarray
    disparity: np.ndarray


def what_is_drawn(folder: Path) -> dict[str, ScoredParts]:
    """By name, of OUT/CLIP."""
    files = {name: folder / name for name in ("gof_0/result.npz", "paper_0/result.npz", "paper_0/background.npz")}
    for file in files.values():
        if not file.is_file():
            raise GofError(f"{file} is missing; make it with python -m gof_benchmark.evidence.real_clips")
    ours, paper, still = (TransientGaussians.load(file) for file in files.values())
    return {
        "still": ScoredParts(still, still),
        "paper": ScoredParts(paper, paper[paper.dynamic]),
        "ours": ScoredParts(TransientGaussians.concatenate([still, ours]), ours),
        "alone": ScoredParts(ours, ours),
    }


def moments(dataset: Dataset, maps: Path) -> Iterator[HeldOutView]:
    """Yield every held-out frame that another follows."""
    for c, camera in enumerate(dataset.cameras):
        board = dataset.board_weight(c)
        for k in dataset.test_frames:
            if k + 1 >= len(dataset.times_s):
                continue
            moves = moving(dataset.image(c, k), dataset.image(c, k + 1), dis)
            flame = moves if board is None else moves & (board > 0.5)
            depth, disparity = (read_depth(maps / kind, camera.name, k) for kind in ("depth", "disparity"))
            yield HeldOutView(camera, float(dataset.camera_times_s(c)[k]), flame, depth, disparity)


def scores(drawn: ScoredParts, moment: HeldOutView) -> tuple[float, float]:
    """Error of inverse depth, and how far off the flame stands; NaN where undefined."""
    disparity = drawn_disparity(drawn.whole, moment.camera, moment.time_s)
    error = rmse_disparity(disparity, moment.disparity, moment.flame)
    picture = render(drawn.part, moment.camera, moment.time_s, background=(0.0, 0.0, 0.0))
    seen = inside(moment.flame) & (picture["alpha"] > VISIBLE)
    off = float(np.median(np.abs(picture["depth"][seen] / moment.depth[seen] - 1))) if seen.any() else np.nan
    return np.nan if error is None else error, off


def row(path: Path, out: Path) -> str:
    """Return a line of the table: means over a clip's held-out pictures."""
    dataset, folder = Dataset.open(path), out / path.name
    drawn = what_is_drawn(folder)
    with progress_bar("depth") as progress:
        write_frame_depths(dataset, dataset.test_frames, folder / "depth", progress=progress)
    views = list(moments(dataset, folder / "depth"))
    cells = []
    for one in drawn.values():
        error, off = np.nanmean([scores(one, moment) for moment in views], axis=0)
        cells += [f"{error:.3f}", f"{100 * off:.1f} %"]
    return f"| {path.name} | {' | '.join(cells)} |"


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(RealDepth, prog="python -m gof_benchmark.evidence.real_depth", args=argv)
    heads = [f"{name}: {figure}" for name in ("still", "paper", "ours", "alone") for figure in ("1/depth", "off")]
    print(f"| clip | {' | '.join(heads)} |")
    print("|---" * (len(heads) + 1) + "|")
    for path in config.datasets:
        print(row(path, config.out), flush=True)


if __name__ == "__main__":
    main()
