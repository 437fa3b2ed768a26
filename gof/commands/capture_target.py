"""`gof capture target`: the ChArUco calibration target as a printable drawing."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path

import tyro

from gof.capture.charuco import Charuco, draw_pdf, draw_svg, page
from gof.commands.everywhere import require_free, write_figures
from gof.commands.read import Millimetres, read_options
from gof.core.errors import GofError
from gof.core.files import atomic_path
from gof.host.options import require_positive

# ----------------------------------------------------------------
# The ChArUco target as options of a command.


@dataclass(frozen=True)
class CharucoOptions:
    """A target of DICT_4X4_50; the paper's is the default."""

    squares: str = "7x5"
    """Squares across and down."""
    square_mm: Millimetres = Charuco.square_mm
    """Side of a square, as measured on the print."""
    charuco_mm: Millimetres = Charuco.marker_mm
    """Side of a marker."""

    def target(self) -> Charuco:
        """Return the target. Raises GofError: a size is not above 0, or --squares is no pair of numbers."""
        require_positive("--square-mm", self.square_mm)
        require_positive("--charuco-mm", self.charuco_mm)
        columns, x, rows = self.squares.partition("x")
        if not (x and columns.isdecimal() and rows.isdecimal()):
            raise GofError(f"--squares {self.squares}: write the squares across and down as 7x5")
        return Charuco(int(columns), int(rows), self.square_mm, self.charuco_mm)


@dataclass(frozen=True)
class TargetConfig:
    """Draw the ChArUco calibration target as a PDF or SVG at true size.

    Examples:
      gof capture target
      gof capture target --out charuco.svg --squares 9x6 --square-mm 25 --charuco-mm 19

    Print at 100 %, measure it with a ruler, glue it on something flat and stiff (glass, composite board).
    """

    out: Path | None = None
    """File to write, .pdf or .svg. Default: out/charuco.pdf, where an older one is replaced."""
    charuco: tyro.conf.OmitArgPrefixes[CharucoOptions] = field(default_factory=CharucoOptions)


def main(argv: list[str]) -> int:
    """Write the drawing."""
    config = read_options(TargetConfig, "capture target", argv)
    target = config.charuco.target()
    target.pattern()  # impossible sizes are named first
    out = config.out or Path("out/charuco.pdf")
    kind = out.suffix.lower()
    if kind not in (".pdf", ".svg"):
        raise GofError(f"{out}: the drawing is a .pdf or an .svg file")
    if config.out is not None:
        require_free(out)
    with atomic_path(out) as temporary:
        temporary.write_bytes(draw_pdf(target) if kind == ".pdf" else draw_svg(target).encode())
    name, width, height = page(target)
    print(f"{out}: {name}, {width:g} x {height:g} mm; print at 100 % and measure it")
    write_figures({"out": str(out)} | asdict(target) | {"paper": name, "width_mm": width, "height_mm": height})
    return 0
