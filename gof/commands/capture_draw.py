"""`gof capture draw`: an LED board template as a printable drawing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.capture.template import BoardTemplate, draw_svg
from gof.commands.board_option import renamed
from gof.core.files import atomic_path, write_json
from gof.host.options import require_number

MOST_MM = 10_000.0


@dataclass(frozen=True)
class DrawConfig:
    """Draw a board template as a printable SVG at true size."""

    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """File to write (.svg)."""
    board: str = "gof_board"
    """Board to draw: gof_board, paper_rig, or the JSON file of your own."""
    marker_mm: float = 60.0
    """Side of the marker in millimetres; everything scales with it."""
    json: Path | None = None
    """Also write the drawn size to this file."""


def main(argv: list[str]) -> int:
    """Write the SVG of a template."""
    config = tyro.cli(DrawConfig, prog="gof capture draw", args=renamed(argv))
    require_number("--marker-mm", config.marker_mm, above=0, most=MOST_MM)
    template = BoardTemplate.load(config.board)
    with atomic_path(config.out) as temporary:
        temporary.write_text(draw_svg(template, config.marker_mm))
    print(f"{config.out}: board '{template.name}', marker side {config.marker_mm:g} mm; print at 100 %")
    if config.json:
        write_json(config.json, {"template": template.name, "marker_mm": config.marker_mm})
    return 0
