"""`gof unpack`: an archive of `gof pack` opened again, every file compared with its checksum."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.core.files import write_json
from gof.dataset.pack import unpack, verify
from gof.host.progress import progress_bar


@dataclass
class UnpackConfig:
    """Unpack archives of `gof pack`, and compare every file with its checksum. A wrong archive leaves nothing behind.

    A folder that was unpacked before is compared with its checksums again.
    """

    archives: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="ARCHIVE ...")]]
    """Archives, or folders that were unpacked."""
    out: Path = Path("data")
    """Folder for the datasets."""
    json: Path | None = None
    """Also write where the datasets are to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof unpack`."""
    config = tyro.cli(UnpackConfig, prog="gof unpack", args=argv)
    folders = []
    for archive in config.archives:
        if archive.is_dir():
            print(f"{archive}: {verify(archive)} files, all as their checksums say")
            folders.append(str(archive))
            continue
        with progress_bar(f"unpack {archive.name}") as update:
            folder = unpack(archive, config.out, update)
        print(f"{folder}: all files are as their checksums say")
        folders.append(str(folder))
    if config.json is not None:
        write_json(config.json, {"datasets": folders})
    return 0
