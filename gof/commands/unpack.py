"""`gof unpack`: an archive of `gof pack` opened again, every file compared with its checksum."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import require_writable, write_figures
from gof.commands.read import read_options
from gof.dataset.pack import unpack, verify
from gof.host.terminal import progress_bar


@dataclass
class UnpackConfig:
    """Unpack archives of `gof pack`, and compare every file with its checksum. A wrong archive leaves nothing behind.

    Examples:
      gof unpack fire.tar --out unpacked

    A folder that was unpacked before is compared with its checksums again.
    """

    archives: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="ARCHIVE ...")]]
    """Archives, or folders that were unpacked."""
    out: Path | None = None
    """Folder for the datasets. Default: beside each archive."""


def main(argv: list[str]) -> int:
    """Run `gof unpack`."""
    config = read_options(UnpackConfig, "unpack", argv)
    folders = []
    for archive in config.archives:
        if archive.is_dir():
            print(f"{archive}: {verify(archive)} files, all as their checksums say")
            folders.append(str(archive))
            continue
        with progress_bar(f"unpack {archive.name}") as update:
            folder = unpack(archive, config.out or require_writable(archive.absolute().parent), update)
        print(f"{folder}: all files are as their checksums say")
        folders.append(str(folder))
    write_figures({"datasets": folders})
    return 0
