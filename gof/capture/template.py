"""Geometry of an LED board relative to its marker, as JSON; and a printable drawing of it (`gof capture draw`)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import tyro

from gof.errors import DataFormatError
from gof.io.files import atomic_path, read_json, write_json

BUILT_IN = ("paper_rig", "gof_board")


@dataclass(frozen=True)
class BoardTemplate:
    """An LED board. Coordinates are in marker sides: origin at the marker's first corner, x along its top edge, y down
    its left edge (as the marker is printed, whichever way the board hangs).

    Args:
        name: of the template.
        marker_id: in DICT_4X4_50.
        inverted: light marker squares on a dark board.
        led_xy: (L, 2) LED positions.
        led_bit: (L,) Gray bit of each LED; -1 for the disambiguation LED.
        strip_ends: (S, 2, 2) first and last lit point of each strip.
        strip_slot: (S,) slot in which each strip is lit.
        outline: (N, 2) polygon around the board, for masks and drawings.
        marker_side_m: size of the printed marker, None when unknown.
        disambiguation_lead: how many periods before the count the disambiguation LED turns, see firmware/core/gof_board.h.
    """

    name: str
    marker_id: int
    inverted: bool
    led_xy: np.ndarray
    led_bit: np.ndarray
    strip_ends: np.ndarray
    strip_slot: np.ndarray
    outline: np.ndarray
    marker_side_m: float | None
    disambiguation_lead: float = 0.6

    @property
    def gray_bits(self) -> int:
        """Number of Gray bits that have an LED."""
        return int(self.led_bit.max()) + 1

    @classmethod
    def load(cls, name: str | Path) -> BoardTemplate:
        """A built-in template by name ("paper_rig", "gof_board") or a JSON file.

        Raises:
            DataFormatError: no such file, or a field is missing or malformed.
        """
        path = files("gof.capture") / f"{name}.json" if str(name) in BUILT_IN else Path(name)
        d = read_json(path)
        try:
            if d["schema"] != "gof-led-board" or d["version"] != 1:
                raise DataFormatError(f"{path}: not a gof-led-board file of version 1")
            template = cls(
                str(d["name"]),
                int(d["marker"]["id"]),
                bool(d["marker"]["inverted"]),
                np.array([led["xy"] for led in d["leds"]], np.float64),
                np.array([led["bit"] if led["bit"] is not None else -1 for led in d["leds"]]),
                np.array([s["ends"] for s in d["strips"]], np.float64),
                np.array([s["slot"] for s in d["strips"]]),
                np.array(d["outline"], np.float64),
                d["marker"].get("side_m"),
                float(d.get("disambiguation_lead", 0.6)),
            )
        except (KeyError, TypeError, ValueError) as e:
            raise DataFormatError(f"{path}: not a board template: field {e} is missing or malformed") from e
        if sorted(template.strip_slot) != list(range(5)) or template.strip_ends.shape != (5, 2, 2):
            raise DataFormatError(f"{path}: 'strips' must be five, with slots 0..4")
        bits = sorted(b for b in template.led_bit if b >= 0)
        if bits != list(range(len(bits))) or not bits:
            raise DataFormatError(f"{path}: 'leds' must hold each Gray bit from 0 up once")
        return template


def draw_svg(template: BoardTemplate, marker_side_mm: float) -> str:
    """Printable SVG at true size: marker, LED holes with labels, strip positions, outline. Cut the strips' length to
    what the drawing shows and mount them flush with the front."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    cells = cv2.aruco.generateImageMarker(dictionary, template.marker_id, 6) > 0  # one pixel per cell
    points = np.vstack([template.outline, template.strip_ends.reshape(-1, 2), template.led_xy, [[0, 0], [1, 1]]])
    low, high = points.min(0) - 0.2, points.max(0) + 0.2

    def mm(p):
        return (np.asarray(p) - low) * marker_side_mm

    width, height = (high - low) * marker_side_mm
    light, dark = "#fff", "#111"
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.2f}mm" height="{height:.2f}mm" '
        f'viewBox="0 0 {width:.2f} {height:.2f}" font-family="sans-serif">',
        f"<title>LED board {template.name}, marker side {marker_side_mm:g} mm</title>",
        '<polygon points="'
        + " ".join(f"{x:.2f},{y:.2f}" for x, y in mm(template.outline))
        + f'" fill="{dark if template.inverted else light}"/>',
    ]
    cell = marker_side_mm / 6
    x0, y0 = mm((0, 0))
    for (row, column), white in np.ndenumerate(cells):
        out.append(
            f'<rect x="{x0 + column * cell:.3f}" y="{y0 + row * cell:.3f}" width="{cell:.3f}" '
            f'height="{cell:.3f}" fill="{light if white != template.inverted else dark}"/>'
        )
    for ends, slot in zip(template.strip_ends, template.strip_slot, strict=True):
        (xa, ya), (xb, yb) = mm(ends)
        out.append(f'<line x1="{xa:.2f}" y1="{ya:.2f}" x2="{xb:.2f}" y2="{yb:.2f}" stroke="#e8d9a0" stroke-width="3"/>')
        out.append(f'<text x="{xa + 2:.2f}" y="{ya + 1.2:.2f}" font-size="3.2" fill="#333">strip {slot}</text>')
    for xy, bit in zip(template.led_xy, template.led_bit, strict=True):
        x, y = mm(xy)
        out.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2.5" fill="#fff" stroke="#888" stroke-width="0.3"/>')
        out.append(
            f'<text x="{x:.2f}" y="{y + 1.1:.2f}" font-size="3" text-anchor="middle" fill="#333">'
            f"{'D' if bit < 0 else bit}</text>"
        )
    return "\n".join([*out, "</svg>", ""])


@dataclass(frozen=True)
class DrawConfig:
    """Draw a board template as a printable SVG at true size."""

    out: tyro.conf.Positional[Path]
    template: str = "gof_board"
    """Built-in name (gof_board, paper_rig) or a JSON file."""
    marker_mm: float = 60.0
    """Side of the marker in millimetres; everything scales with it."""
    json: Path | None = None
    """Also write the drawn size to this file."""


def main(argv: list[str]) -> int:
    """Write the SVG of a template."""
    config = tyro.cli(DrawConfig, prog="gof capture draw", args=argv)
    template = BoardTemplate.load(config.template)
    with atomic_path(config.out) as temporary:
        temporary.write_text(draw_svg(template, config.marker_mm))
    print(f"{config.out}: board '{template.name}', marker side {config.marker_mm:g} mm; print at 100 %")
    if config.json:
        write_json(config.json, {"template": template.name, "marker_mm": config.marker_mm})
    return 0
