"""`gof capture target`: the ChArUco calibration target as a printable drawing."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from gof.capture.charuco import Charuco, draw_pdf, draw_svg, page
from gof.core.errors import GofError
from gof.core.files import atomic_path, write_json
from gof.host.options import require_positive


@dataclass(frozen=True)
class TargetConfig:
    """Draw the ChArUco calibration target as a PDF or SVG at true size.

    Print at 100 %, measure it with a ruler, glue it on something flat and stiff (glass, composite board).
    """

    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """File to write, .pdf or .svg."""
    target: tyro.conf.OmitArgPrefixes[Charuco] = field(default_factory=Charuco)
    json: Path | None = None
    """Also write the drawn size to this file."""


def main(argv: list[str]) -> int:
    """Write the drawing."""
    config = tyro.cli(TargetConfig, prog="gof capture target", args=argv)
    require_positive("--square-mm", config.target.square_mm)
    require_positive("--marker-mm", config.target.marker_mm)
    kind = config.out.suffix.lower()
    if kind not in (".pdf", ".svg"):
        raise GofError(f"{config.out}: the drawing is a .pdf or an .svg file")
    with atomic_path(config.out) as temporary:
        temporary.write_bytes(draw_pdf(config.target) if kind == ".pdf" else draw_svg(config.target).encode())
    name, width, height = page(config.target)
    print(f"{config.out}: {name}, {width:g} x {height:g} mm; print at 100 % and measure it")
    if config.json:
        write_json(config.json, asdict(config.target) | {"paper": name, "width_mm": width, "height_mm": height})
    return 0
