"""`gof import`: a reconstruction into a .blend as an animated point cloud, and one rendered preview frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.core.files import require_replaceable, write_json
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.host import extras
from gof.host.processes import python_command
from gof.host.worker import run_worker
from gof.look.preview import Preview


@dataclass
class ImportConfig:
    """Result -> animated point cloud in a .blend that also holds the dataset's scene, and a rendered preview frame."""

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """result.npz or result.ply of a reconstruction."""
    dataset: Path
    """The dataset it was made from: its scene and cameras go into the .blend."""
    blend: Path = Path("out/result.blend")
    """The .blend to write."""
    preview: Path | None = None
    """Rendered picture of the cloud (PNG); default: beside the .blend."""
    frame: int | None = None
    """Frame to render; default: the middle of the clip."""
    camera: str | None = None
    """Camera to render from; default: the middle one."""
    mode: Literal["points", "ellipsoids"] = "points"
    """How the cloud is drawn: round points (quick), or each Gaussian's own ellipsoid (about three times the render
    time)."""
    samples: int = 16
    """Cycles samples per pixel of the preview."""
    json: Path | None = None
    """Also write the files' names and the cost to this file."""


def main(argv: list[str]) -> int:
    """`gof import RESULT --dataset DATASET --blend FILE`; see --help."""
    config = tyro.cli(ImportConfig, prog="gof import", args=argv)
    dataset = Dataset.open(config.dataset)
    TransientGaussians.load(config.result)  # a bad file is named here, before Blender starts
    preview = config.preview or config.blend.with_suffix(".png")
    for path in (config.blend, preview):
        require_replaceable(path)
    frame = len(dataset.times_s) // 2 if config.frame is None else config.frame
    camera = config.camera or dataset.cameras[len(dataset.cameras) // 2].name
    config.blend.parent.mkdir(parents=True, exist_ok=True)
    options = {
        "result": config.result,
        "dataset": config.dataset,
        "blend": config.blend,
        "preview": preview,
        "frame": frame,
        "camera": camera,
        "mode": config.mode,
        "samples": config.samples,
    }
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    worker = python_command("-m", "gof_blender.worker.import_result", *words)
    extras.require("bpy", "blender", "gof import")
    cost = run_worker(worker, "import into Blender")
    names = [c.name for c in dataset.cameras]
    # Which truth the preview belongs to, for `gof report`.
    Preview(preview.name, names.index(camera), frame).write(preview.with_suffix(".json"))
    if config.json:
        files = {"blend": str(config.blend), "preview": str(preview)}
        write_json(config.json, files | {"seconds": cost.seconds, "peak_mb": cost.peak_mb})
    print(f"{config.blend} and {preview} ({cost.seconds:.1f} s): open the .blend and press play")
    return 0
