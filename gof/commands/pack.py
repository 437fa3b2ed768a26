"""`gof pack`: datasets as archives for a data host."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import require_free, require_writable, write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.dataset.pack import pack
from gof.host.terminal import progress_bar


@dataclass
class PackConfig:
    """Pack each dataset into one archive with checksums and a card: content, authors, licence.

    Examples:
      gof pack data/fire --licence CC-BY-4.0 --authors "Your Name"

    Others open it with: gof unpack NAME.tar, or with tar and sha256sum.
    """

    datasets: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="DATASET ...")]]
    """Dataset folders."""
    licence: str = ""
    """Must be given: what others may do with it, as data hosts name licences: CC-BY-4.0."""
    authors: tuple[str, ...] = ()
    """Must be given: who made it."""
    out: Path | None = None
    """Folder for NAME.tar and NAME.tar.sha256; archives that are there are kept. Default: beside the first dataset."""


def main(argv: list[str]) -> int:
    """Run `gof pack`."""
    config = read_options(PackConfig, "pack", argv)
    require_stated(config)
    made = {}
    datasets = {folder: Dataset.open(folder) for folder in config.datasets}  # all of them, before any is packed
    out = config.out or require_writable(config.datasets[0].absolute().parent)
    require_free(*(out / f"{folder.absolute().name}.tar" for folder in datasets))
    for folder, dataset in datasets.items():
        with progress_bar(f"pack {folder.name}") as update:
            archive = pack(dataset, out, config.licence, config.authors, update)
        made[folder.name] = archive.stat().st_size
        print(f"{archive}: {archive.stat().st_size / 1e6:.1f} MB")
    write_figures({"archives": made})
    return 0


def require_stated(config: PackConfig) -> None:
    """Raise GofError: the licence or the authors are missing; it names both, and the whole command."""
    licence, authors = config.licence.strip(), [name for name in config.authors if name.strip()]
    missing = ["--licence"] * (not licence) + ["--authors"] * (not authors)
    if missing:
        words = ["gof", "pack", *map(str, config.datasets), "--licence", licence or "CC-BY-4.0"]
        words += ["--authors", *(authors or ["YOUR NAME"])]
        words += [] if config.out is None else ["--out", str(config.out)]
        raise GofError(
            f"{' and '.join(missing)} missing: a packed dataset says what others may do with it and who made it. For "
            f"example: {shlex.join(words)}"
        )
