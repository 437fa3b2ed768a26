"""`gof report`: pictures, scores and costs of a reconstruction on one page, OUT/report.html."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from filecmp import cmp
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.commands.video import camera_number
from gof.core.costs import StageCost, StageLog
from gof.core.errors import GofError
from gof.core.files import digest
from gof.dataset import Dataset
from gof.evaluate.leaderboard import EvaluatedResult, about
from gof.evaluate.scores import Scores
from gof.host.terminal import progress_bar
from gof.look.animation import brightest_frame
from gof.look.charts import frame_chart
from gof.look.comparison import fire_removal
from gof.look.drawing import Kind, require_figure
from gof.look.pages import page_pictures
from gof.look.player.opened import newest
from gof.look.report import PREVIEW, Preview, build_report

TWINS = (".npz", ".ply")  # one result in both, as `gof reconstruct` writes it


@dataclass
class ReportConfig:
    """Write OUT/report.html: pictures, animation, scores and costs of a reconstruction on one self-contained page.

    Examples:
      gof report out/fire --dataset data/fire

    Reads OUT/scores.json (of `gof evaluate`), costs.json of the dataset, the result's folder and OUT, the
    stage pictures beside the result, and OUT/preview.json of `gof import` when there is one.
    """

    out_dir: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Folder of the report; it holds scores.json."""
    dataset: Path | None = None
    """Dataset folder; default OUT/dataset."""
    result: Path | None = None
    """Result that was scored, a file or its folder; default OUT/result.npz, OUT/reconstruct/result.npz, or what
    scores.json names."""
    camera: str | None = None
    """Name of the camera of the animation; default the middle one."""
    figure: tuple[Kind, ...] = ()
    """Also write the chart of L2 over time for print: OUT/pictures/l2.pdf and so on."""


def main(argv: list[str]) -> int:
    """Run `gof report`."""
    config = read_options(ReportConfig, "report", argv)
    out = config.out_dir
    scores = Scores.read(out / "scores.json")
    dataset = Dataset.open(config.dataset or out / "dataset")
    camera = None if config.camera is None else camera_number(_renamed(config.camera, dataset), dataset)
    result = newest(config.result) if config.result else _result_in(out, scores)
    _require_scored(result, scores)
    preview = Preview.read(out / PREVIEW) if (out / PREVIEW).exists() else None
    twins = {digest(file) for file in (result.with_suffix(kind) for kind in TWINS) if file.is_file()}
    if preview is not None and preview.result not in (None, digest(result), *twins):
        print(f"note: {preview.image} is of another result and is left out; make it again with 'gof import'")
        preview = None
    charts = [out / "pictures" / f"l2.{kind}" for kind in config.figure]
    require_figure(*charts)
    removal = fire_removal(dataset, brightest_frame(dataset), range(len(dataset.cameras)), result)
    with progress_bar("report") as progress:
        path = build_report(
            out,
            dataset,
            result,
            scores,
            _stages([dataset.path, result.parent, out]),
            preview,
            camera=camera,
            fire_removal=page_pictures(removal),
            train_s=EvaluatedResult.of(out, about(out), scores).train_s,
            progress=progress,
        )
    chart = frame_chart(scores)
    for path_of_chart in charts:
        if chart is None:
            print(f"{path_of_chart}: not written, fewer than two frames have a score of velocity")
        else:
            chart.write(path_of_chart)
    write_figures({"report": str(path), "bytes": path.stat().st_size})
    print(f"{path} ({path.stat().st_size / 2**20:.1f} MB)")
    return 0


def _renamed(camera: str, dataset: Dataset) -> str:
    """Return the camera's name, also where its number was given, as in the version before."""
    names = [known.name for known in dataset.cameras]
    if camera in names or not camera.isdecimal() or int(camera) >= len(names):
        return camera
    new = names[int(camera)]
    print(f"gof report: --camera {camera} is now --camera {new}; numbers go with the next version", file=sys.stderr)
    return new


def _result_in(out: Path, scores: Scores) -> Path:
    first, second = out / "result.npz", out / "reconstruct" / "result.npz"
    scored = Path(scores.import_.path) if scores.import_.path else first
    return next((path for path in (first, second, scored) if path.exists()), first)


def _require_scored(result: Path, scores: Scores) -> None:
    """Raise GofError where the result is not the one that was scored: a page shows one result."""
    if not result.is_file():
        raise GofError(f"{result}: no result of `gof reconstruct`; name the one that was scored with --result")
    scored = Path(scores.import_.path) if scores.import_.path else result
    same = not (scored.is_file() and result.is_file()) or scored.samefile(result) or cmp(scored, result, shallow=False)
    if not same:
        raise GofError(
            f"the scores are those of {scored}, and the pictures would be of {result}: leave out --result, or evaluate "
            f"that one first, gof evaluate {result} --dataset DATASET --out FOLDER"
        )


def _stages(folders: list[Path]) -> list[StageCost]:
    """Return the content of the folders' costs.json, each folder once."""
    once = dict.fromkeys(folder.resolve() for folder in folders)
    return [stage for folder in once for stage in StageLog(folder / "costs.json").stages()]
