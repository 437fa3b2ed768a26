"""`gof share`: write results to one HTML file that plays, to send to other people."""

from __future__ import annotations

import webbrowser
from dataclasses import asdict, dataclass
from pathlib import Path

from gof.commands.everywhere import beside, require_free, write_figures
from gof.commands.read import Megabytes, Results, named, read_options
from gof.dataset import Dataset
from gof.dataset.leaks import print_of_others
from gof.host.options import require_number
from gof.host.terminal import console, progress_bar
from gof.look.player.opened import dataset_beside, open_result
from gof.look.player.page import in_words, share_page


@dataclass
class ShareConfig:
    """Write results to one HTML file that plays in any browser, also on a phone, from the disk and without a network.

    Examples:
      gof share out/demo                                   a demo, with everything beside it
      gof share out/fire --dataset data/fire               one result and what was filmed
      gof share ours=out/fire theirs=out/other.ply --dataset data/fire      side by side, with one camera

    It has the Gaussians themselves (quantised; what that costs is measured and printed), so that one can stop time,
    play at 1/100 of the speed, turn the camera, colour by speed or its uncertainty, and show velocity lines. With
    --dataset it also has the dataset's cameras, the scene behind the flame, the recorded pictures, and the true
    velocity where it is known.
    """

    results: Results
    """Folders of `gof reconstruct`, or files of any method of docs/importers.md, in one world and on one clock; the
    name is what people read, default: the folder's."""
    dataset: Path | None = None
    """Dataset folder: cameras, plates, recorded pictures, true velocity; default: the one in a demo's folder."""
    out: Path | None = None
    """File to write. Default: share.html in the first result's folder, where an older one is replaced."""
    title: str | None = None
    """Heading; default: the dataset's name."""
    pictures: Megabytes = 2.0
    """Room for recorded pictures; 0 leaves them out."""
    open: bool = False
    """Open the file in the browser of this machine."""


def main(argv: list[str]) -> int:
    """Run `gof share`."""
    config = read_options(ShareConfig, "share", argv)
    require_number("--pictures", config.pictures, least=0, most=1000)
    asked = named(config.results)
    if config.out is not None:
        require_free(config.out)
    results = [open_result(path, name=name) for name, path in asked]
    first = asked[0][1]
    folder = config.dataset or dataset_beside(first)
    dataset = None if folder is None else Dataset.open(folder)
    print_of_others((result.path for result in results), dataset)
    out = config.out or beside(first, "share.html")
    with progress_bar("share") as progress:
        made = share_page(results, out, dataset, config.title, config.pictures, progress)
    terminal = console()
    for result, size, agreement in zip(results, made.gaussian_bytes, made.agreement, strict=True):
        terminal.print(
            f"{result.name}: {len(result.gaussians):,} Gaussians in {size / 1e6:.2f} MB; {in_words(agreement)}"
        )
    for note in made.notes:
        terminal.print(note)
    write_figures(_figures(made, results))
    terminal.print(f"{made.path} ({made.bytes / 1e6:.1f} MB), open it in any browser")
    if config.open:
        webbrowser.open(made.path.resolve().as_uri())
    return 0


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
