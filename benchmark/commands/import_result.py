"""`gof import`: a reconstruction into a .blend as an animated point cloud, and one rendered preview frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.commands.everywhere import beside, require_free, write_figures
from gof.commands.read import read_options
from gof.core.files import digest, require_replaceable
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.host import extras
from gof.host.processes import python_command
from gof.host.worker import run_worker
from gof.look.report import PREVIEW, Preview

SAMPLES = 16  # per pixel of the preview at most; a dataset's own pictures may have fewer


@dataclass
class ImportConfig:
    """Result -> animated point cloud in a .blend that also holds the dataset's scene, and a rendered preview frame.

    Examples:
      gof import out/fire --dataset data/fire
    """

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Folder of a reconstruction, or its result.npz or result.ply."""
    dataset: Path
    """The dataset it was made from: its scene and cameras go into the .blend."""
    out: Path | None = None
    """The .blend to write. Default: result.blend beside the result, where an older one is replaced."""
    preview: Path | None = None
    """Rendered picture of the cloud (PNG). Default: beside the .blend."""
    frame: int | None = None
    """Frame to render; default: the middle of the clip."""
    camera: str | None = None
    """Camera to render from; default: the middle one."""
    mode: Literal["points", "ellipsoids", "splats"] = "points"
    """Shapes of the cloud: round points; each Gaussian's own ellipsoid (about three times the render time); or
    Blender's own splats (5.3: the quickest)."""


def main(argv: list[str]) -> int:
    """`gof import RESULT --dataset DATASET [--out FILE]`; see --help."""
    config = read_options(ImportConfig, "import", argv)
    dataset = Dataset.open(config.dataset)
    result = config.result / "result.npz" if config.result.is_dir() else config.result
    TransientGaussians.load(result)  # a bad file is named here, before Blender starts
    blend = config.out or beside(result.absolute(), "result.blend")
    preview = config.preview or blend.with_suffix(".png")
    if config.out is not None:
        require_free(blend, preview)
    elif config.preview is not None:
        require_free(preview)
    for path in (blend, preview):
        require_replaceable(path)
    record = preview.parent / PREVIEW
    if record.exists():
        Preview.read(record)  # what is none is not replaced
    frame = len(dataset.times_s) // 2 if config.frame is None else config.frame
    camera = config.camera or dataset.cameras[len(dataset.cameras) // 2].name
    blend.parent.mkdir(parents=True, exist_ok=True)
    options = {
        "result": result,
        "dataset": config.dataset,
        "blend": blend,
        "preview": preview,
        "frame": frame,
        "camera": camera,
        "mode": config.mode,
        "samples": SAMPLES,
    }
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    # All that may not be replaced has been refused above.
    worker = python_command("-m", "gof_blender.worker.import_result", *words, "--overwrite")
    extras.require("bpy", "blender", "gof import")
    cost = run_worker(worker, "import into Blender")
    names = [c.name for c in dataset.cameras]
    # Which truth and which result the preview belongs to, for `gof report`.
    Preview(preview.name, names.index(camera), frame, digest(result)).write(record)
    files = {"blend": str(blend), "preview": str(preview)}
    write_figures(files | {"seconds": cost.seconds, "peak_mb": cost.peak_mb})
    print(f"{blend} and {preview} ({cost.seconds:.1f} s): open the .blend and press play")
    return 0
