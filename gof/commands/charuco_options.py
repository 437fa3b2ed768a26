"""The ChArUco target as options of a command."""

from __future__ import annotations

from dataclasses import dataclass

from gof.capture.charuco import Charuco
from gof.commands.units import Millimetres
from gof.core.errors import GofError
from gof.host.options import require_positive


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
        """The target. Raises GofError: a size is not above 0, or --squares is no pair of numbers."""
        require_positive("--square-mm", self.square_mm)
        require_positive("--charuco-mm", self.charuco_mm)
        columns, x, rows = self.squares.partition("x")
        if not (x and columns.isdecimal() and rows.isdecimal()):
            raise GofError(f"--squares {self.squares}: write the squares across and down as 7x5")
        return Charuco(int(columns), int(rows), self.square_mm, self.charuco_mm)
