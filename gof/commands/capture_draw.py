"""`gof capture draw`: an LED board template as a printable drawing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gof.capture.template import BoardTemplate, draw_svg
from gof.commands.everywhere import require_free, write_figures
from gof.commands.read import Millimetres, read_options
from gof.core.files import atomic_path
from gof.host.options import require_number

MOST_MM = 10_000.0


@dataclass(frozen=True)
class DrawConfig:
    """Draw a board template as a printable SVG at true size.

    Examples:
      gof capture draw --marker-mm 60
    """

    out: Path | None = None
    """File to write (.svg). Default: out/BOARD.svg, where an older one is replaced."""
    board: str = "gof_board"
    """Board to draw: gof_board, paper_rig, or the JSON file of your own."""
    marker_mm: Millimetres = 60.0
    """Side of the marker; everything scales with it."""


def main(argv: list[str]) -> int:
    """Write the SVG of a template."""
    config = read_options(DrawConfig, "capture draw", argv)
    require_number("--marker-mm", config.marker_mm, above=0, most=MOST_MM)
    template = BoardTemplate.load(config.board)
    if config.out is not None:
        require_free(config.out)
    out = config.out or Path("out") / f"{template.name}.svg"
    with atomic_path(out) as temporary:
        temporary.write_text(draw_svg(template, config.marker_mm))
    print(f"{out}: board '{template.name}', marker side {config.marker_mm:g} mm; print at 100 %")
    write_figures({"out": str(out), "template": template.name, "marker_mm": config.marker_mm})
    return 0
