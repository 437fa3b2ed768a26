"""`gof share`: results in one HTML file that moves, to send to somebody."""

from __future__ import annotations

import webbrowser
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.foreign_options import ForeignOptions
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.host.options import require_number
from gof.host.progress import progress_bar
from gof.host.terminal import console
from gof.look.player.opened import dataset_beside, open_result
from gof.look.player.page import in_words, share_page


@dataclass
class ShareConfig:
    """Write results to one HTML file that plays in any browser, also on a phone, from the disk and without a network.

    It has the Gaussians themselves (quantised; what that costs is measured and printed), so that one can stop time,
    play at 1/100 of the speed, turn the camera, colour by speed or by its doubt, and show velocity lines. With
    --dataset it also has the dataset's cameras, the scene behind the flame, the recorded pictures, and the true
    velocity where it is known.

    What people type:
      gof share out/demo                                   a demo, with everything beside it
      gof share out/fire --dataset data/fire               one result and what was filmed
      gof share out/fire out/other.ply --names ours theirs --dataset data/fire      side by side, with one camera
    """

    results: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RESULT ...")]]
    """Folders of `gof reconstruct`, or files of any method of docs/importers.md, in one world and on one clock."""
    other_method: tyro.conf.OmitArgPrefixes[ForeignOptions]
    dataset: Path | None = None
    """Dataset folder: cameras, plates, recorded pictures, true velocity; default: the one in a demo's folder."""
    out: Path | None = None
    """File to write; default: share.html in the first result's folder. An older one is replaced."""
    title: str | None = None
    """Heading; default: the dataset's name."""
    names: tuple[str, ...] = ()
    """What the results are called, in their order; default: their folders' names."""
    pictures: float = 2.0
    """Megabytes that recorded pictures may take; 0 leaves them out."""
    frame_time: float | None = None
    """Seconds between two frames, for results that count frames."""
    open: bool = False
    """Open the file in the browser of this machine."""
    json: Path | None = None
    """Also write sizes and the quantisation's cost to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof share`."""
    config = tyro.cli(ShareConfig, prog="gof share", args=argv)
    require_number("--pictures", config.pictures, least=0, most=1000)
    if not config.results:
        raise GofError("name a result: a folder of `gof reconstruct`, or a file of a method")
    if config.names and len(config.names) != len(config.results):
        raise GofError(f"--names: {len(config.names)} names for {len(config.results)} results; give one for each")
    options = config.other_method.options(config.frame_time)
    names = config.names or (None,) * len(config.results)
    results = [open_result(path, options, name) for path, name in zip(config.results, names, strict=True)]
    folder = config.dataset or dataset_beside(config.results[0])
    dataset = None if folder is None else Dataset.open(folder)
    out = config.out or _default_out(config.results[0])
    with progress_bar("share") as progress:
        made = share_page(results, out, dataset, config.title, config.pictures, progress)
    terminal = console()
    for result, size, agreement in zip(results, made.gaussian_bytes, made.agreement, strict=True):
        terminal.print(
            f"{result.name}: {len(result.gaussians):,} Gaussians in {size / 1e6:.2f} MB; {in_words(agreement)}"
        )
    for note in made.notes:
        terminal.print(note)
    if config.json:
        write_json(config.json, _figures(made, results))
    terminal.print(f"{made.path} ({made.bytes / 1e6:.1f} MB), open it in any browser")
    if config.open:
        webbrowser.open(made.path.resolve().as_uri())
    return 0


def _default_out(result: Path) -> Path:
    return result / "share.html" if result.is_dir() else result.with_name("share.html")


def _figures(made, results) -> dict:
    def finite(agreement):
        return {key: value if abs(value) < float("inf") else None for key, value in asdict(agreement).items()}

    return {
        "share": str(made.path),
        "bytes": made.bytes,
        "results": [
            {"name": r.name, "gaussians": len(r.gaussians), "bytes": size, **finite(a)}
            for r, size, a in zip(results, made.gaussian_bytes, made.agreement, strict=True)
        ],
    }
