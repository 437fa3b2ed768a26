"""`gof report`: pictures, scores and costs of a reconstruction on one page, OUT/report.html."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.core.costs import StageCost, StageLog
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.evaluate.scores import Scores
from gof.host.progress import progress_bar
from gof.look.animation import brightest_frame
from gof.look.charts import Kind, frame_chart, require_figure
from gof.look.fire_removal import fire_removal
from gof.look.pages import page_pictures
from gof.look.preview import Preview
from gof.look.report import build_report


@dataclass
class ReportConfig:
    """Write OUT/report.html: pictures, animation, scores and costs of a reconstruction on one self-contained page.

    Reads OUT/scores.json (of `gof evaluate --out OUT`), costs.json of the dataset, the result's folder and OUT, the
    stage pictures beside the result, and OUT/preview.json of `gof import` when there is one.
    """

    out_dir: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Folder of the report; it holds scores.json."""
    dataset: Path | None = None
    """Dataset folder; default OUT/dataset."""
    result: Path | None = None
    """Result file; default OUT/result.npz, or OUT/reconstruct/result.npz."""
    camera: int | None = None
    """Number of the camera of the animation; default the middle one."""
    figure: tuple[Kind, ...] = ()
    """Also write the chart of L2 over time for print: OUT/pictures/l2.pdf and so on."""
    json: Path | None = None
    """Also write the page's name and size to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof report`."""
    config = tyro.cli(ReportConfig, prog="gof report", args=argv)
    out = config.out_dir
    scores = Scores.read(out / "scores.json")
    dataset = Dataset.open(config.dataset or out / "dataset")
    if config.camera is not None and not 0 <= config.camera < len(dataset.cameras):
        raise GofError(f"--camera {config.camera}: the dataset has cameras 0 to {len(dataset.cameras) - 1}")
    result = config.result or _result_in(out)
    preview = Preview.read(out / "preview.json") if (out / "preview.json").exists() else None
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
            camera=config.camera,
            fire_removal=page_pictures(removal),
            progress=progress,
        )
    chart = frame_chart(scores)
    for path_of_chart in charts:
        if chart is None:
            print(f"{path_of_chart}: not written, fewer than two frames have a score of velocity")
        else:
            chart.write(path_of_chart)
    if config.json:
        write_json(config.json, {"report": str(path), "bytes": path.stat().st_size})
    print(f"{path} ({path.stat().st_size / 2**20:.1f} MB)")
    return 0


def _result_in(out: Path) -> Path:
    first, second = out / "result.npz", out / "reconstruct" / "result.npz"
    return second if second.exists() and not first.exists() else first


def _stages(folders: list[Path]) -> list[StageCost]:
    """What the costs.json of the folders say, each folder once."""
    once = dict.fromkeys(folder.resolve() for folder in folders)
    return [stage for folder in once for stage in StageLog(folder / "costs.json").stages()]
