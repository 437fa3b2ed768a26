"""`gof view`: a result in the browser."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.read import read_options
from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.host.options import require_number
from gof.look.player.live import HOST, Live, serve
from gof.look.player.opened import dataset_beside


@dataclass
class ViewConfig:
    """Show a result in the browser, with the page of gof share. It follows a reconstruction that still runs: the latest
    snapshot appears, and the view stays.

    The page is for this machine alone. From another: ssh -L 8080:127.0.0.1:PORT, or send the file of gof share.

    Examples:
      gof view out/fire --dataset data/fire
    """

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Result of `gof reconstruct` (file or folder, finished or not), or of any method that docs/importers.md lists."""
    dataset: Path | None = None
    """Dataset folder: cameras, plates, recorded pictures, true velocity; default: the one in a demo's folder."""
    port: int = 0
    """The page is http://127.0.0.1:PORT; 0: any port that is free."""
    open: bool = False
    """Open the page in the browser of this machine."""


def main(argv: list[str]) -> int:
    """Run `gof view`; ends with Ctrl-C."""
    if any(word.partition("=")[0] == "--host" for word in argv):  # of 0.2
        raise GofError(
            f"--host: the page is for this machine alone now; from another, ssh -L 8080:{HOST}:PORT with the --port "
            "that you give here, or send the file of gof share"
        )
    config = read_options(ViewConfig, "view", argv)
    require_number("--port", config.port, least=0, most=65535)
    if not config.result.exists():
        raise DataFormatError(f"{config.result}: no such file or folder")
    folder = config.dataset or dataset_beside(config.result)
    live = Live(config.result, None if folder is None else Dataset.open(folder))
    with serve(live, config.port) as server, suppress(KeyboardInterrupt):
        address = f"http://{HOST}:{server.server_address[1]}"
        print(f"{address}  (Ctrl-C ends it)", flush=True)
        if config.open:
            webbrowser.open(address)
        server.serve_forever()
    return 0
