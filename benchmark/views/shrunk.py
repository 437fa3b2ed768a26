"""A dataset with smaller pictures, in a folder of its own: `python -m gof_benchmark.views.shrunk DATASET OUT`.

For trainings on few cores: views (`gof generate` writes them) refer to pictures as they are. The truth and the spec are
linked, not copied: a scene of the suite stays one, in a folder with its size's and its own name. Pictures are area
means; linear pictures and true flow are left out.
"""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro

from gof.core.description import FILE
from gof.core.drafts import whole_folder
from gof.core.errors import GofError
from gof.core.files import atomic_path, path_in
from gof.dataset import CameraEntry, Dataset
from gof.host import extras
from gof.host.terminal import console
from gof_blender.pure.layout import Layout

from . import write as write_view
from .source import ViewSource, link

WITHOUT_DEPTH = ("dnerf", "nerfstudio")  # layouts that read nothing of the plates' depth
SHRUNK = "pictures"  # in a dataset's provenance: how its pictures were made smaller


@dataclass
class ShrunkConfig:
    """Write a dataset with smaller pictures, and views of it for other methods."""

    dataset: tyro.conf.Positional[Path]
    """A finished dataset."""
    out: tyro.conf.Positional[Path]
    """Folder to write; it must not be there."""
    max_size: Annotated[int, tyro.conf.arg(metavar="PX")] = 160
    """Longer side of the pictures."""
    views: tuple[str, ...] = ()
    """Layouts to write in it: as --views of gof generate."""


def shrink(root: Path, out: Path, longest_side: int, views: tuple[str, ...] = ()) -> None:
    """Write a dataset with smaller pictures and views of it; nothing where something fails.

    Args:
        longest_side: of the pictures, px.   views: layouts; the plates' depth is written where one of them reads it.
    Raises:
        GofError: `out` is there, the pictures are not larger, or a layout cannot express the dataset.
        MissingDependencyError: a layout reads depth and OpenEXR is absent.
    """
    source = ViewSource.open(root)
    dataset = source.dataset
    if out.exists():
        raise GofError(f"{out}: is there already; give a new folder")
    if all(max(camera.width, camera.height) <= longest_side for camera in dataset.cameras):
        raise GofError(f"{root}: its pictures are not larger than {longest_side} px")
    depth = any(name not in WITHOUT_DEPTH for name in views)
    if depth:
        extras.load("OpenEXR", "generate", "writing depth")  # before anything is written
    with whole_folder(out) as draft:
        _write(source, draft, longest_side, depth)
        for name in views:
            write_view(name, draft)


def _write(source: ViewSource, out: Path, longest_side: int, depth: bool) -> None:
    dataset, entries = source.dataset, []
    known = [entry for entry in dataset.description.cameras if entry.role != "around"]
    for number, (camera, entry) in enumerate(zip(dataset.cameras, known, strict=True)):
        factor = longest_side / max(camera.width, camera.height)
        small = entry.camera().scaled(round(camera.width * factor), round(camera.height * factor))
        for kind in ("rgb", "static", "mask", "board_mask"):
            if getattr(entry, kind) is not None:
                _shrink_pictures(dataset, number, kind, out, (small.width, small.height))
        if depth:
            _shrink_depth(source, number, out, (small.width, small.height))
        kept = {name: getattr(entry, name) for name in ("role", "roll_deg", "rgb", "static", "mask", "board_mask")}
        entries.append(CameraEntry.of(small, time_s=entry.time_s, **kept))
    for name in (dataset.description.velocity, "grids"):
        if name and path_in(dataset.path, name).is_dir():
            shutil.copytree(path_in(dataset.path, name), path_in(out, name), copy_function=_link)
    spec = Layout(dataset.path).spec
    if spec.is_file():
        link(spec, Layout(out).spec)
    note = {SHRUNK: f"area means of {dataset.description.name}, at most {longest_side} px"}
    described = replace(dataset.description, cameras=tuple(entries), provenance=dataset.description.provenance | note)
    described.write(out)


def _link(source: str, target: str) -> None:
    link(Path(source), Path(target))


def _shrink_pictures(dataset: Dataset, camera: int, kind: str, out: Path, size: tuple[int, int]) -> None:
    frames = range(len(dataset.times_s)) if kind in ("rgb", "mask") else [0]
    for frame in frames:
        picture = cv2.imread(str(dataset.file(camera, kind, frame)), cv2.IMREAD_UNCHANGED)
        target = path_in(out, dataset.name(camera, kind, frame))
        with atomic_path(target) as temporary:
            cv2.imwrite(str(temporary), cv2.resize(picture, size, interpolation=cv2.INTER_AREA))


def _plate_depth(source: ViewSource, camera: int) -> Path:
    name = Path(source.dataset.name(camera, "static")).with_suffix(".exr").as_posix()
    return path_in(source.dataset.path, name)


def _shrink_depth(source: ViewSource, camera: int, out: Path, size: tuple[int, int]) -> None:
    """Write the plate's depth, where it is known: of one of the old pixels under each new one."""
    path = _plate_depth(source, camera)
    if not path.is_file():
        return
    name = path.relative_to(source.dataset.path).as_posix()
    OpenEXR = extras.load("OpenEXR", "generate", "writing depth")
    depth = np.minimum(source.plate_depth(camera), np.float32(1e10))
    channels = {"Z": cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)}
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic_path(path_in(out, name)) as temporary, OpenEXR.File(head, channels) as file:
        file.write(str(temporary))


def main(argv: list[str] | None = None) -> int:
    """1 with a named error."""
    argv = sys.argv[1:] if argv is None else argv
    old = "--longest-side"
    if any(word.partition("=")[0] == old for word in argv):
        print(f"{old} is now --max-size; the old name goes with the next version", file=sys.stderr)
        argv = [word.replace(old, "--max-size", 1) if word.partition("=")[0] == old else word for word in argv]
    config = tyro.cli(ShrunkConfig, prog="python -m gof_benchmark.views.shrunk", args=argv)
    try:
        shrink(config.dataset, config.out, config.max_size, config.views)
    except GofError as error:
        console().print("error:", error, style="red")
        return 1
    print(f"{config.out / FILE}: pictures of at most {config.max_size} px; views: {', '.join(config.views) or 'none'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
