"""`gof view`: a result in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.read import read_options
from gof.dataset import Dataset
from gof.host.options import require_number
from gof.look.viewer import Viewer


@dataclass
class ViewConfig:
    """A result in the browser: 3D, with a time slider. Of a reconstruction that still runs, the latest snapshot.

    Examples:
      gof view out/fire --dataset data/fire
    """

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Result of `gof reconstruct` (file or folder, finished or not), or of any method that docs/importers.md lists."""
    dataset: Path | None = None
    """Dataset folder: shows its cameras with their pictures, and knows the frame times."""
    port: int = 8080
    """The page is http://localhost:PORT."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other machines look."""


def main(argv: list[str]) -> int:
    """`gof view RESULT [--dataset D] [--port N]`; ends with Ctrl-C."""
    config = read_options(ViewConfig, "view", argv)
    require_number("--port", config.port, least=0, most=65535)
    dataset = None if config.dataset is None else Dataset.open(config.dataset)
    viewer = Viewer(config.result, dataset, config.host, config.port)
    print(f"http://localhost:{viewer.server.get_port()}  (Ctrl-C ends it)", flush=True)
    viewer.run()
    return 0
