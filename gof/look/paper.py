"""Figures for print: tiles on a page as PDF or SVG, in which letters, lines and legends are vectors, or as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gof.look.drawing import LETTERS, SMALL, Chart, text_width_in
from gof.look.tiles import BOX_COLOURS, Bar, Row, Tile, Wheel
from gof.look.velocity import legend as wheel_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VECTOR = (".pdf", ".svg")
WIDTH_IN = 7.0  # of a page's two columns
ROOM = 0.97  # of a tile's width, for words: a picture of letters is a little wider than their outlines
TITLE_IN, NOTE_IN, LEGEND_IN, GAP_IN = 0.15, 0.11, 0.34, 0.05
WHEEL_IN = 0.28


def write_sheet(path: Path, rows: Sequence[Row], width_in: float = WIDTH_IN, lettered: bool = True) -> None:
    """Write rows of tiles, each with its title above and its legend below; all columns have one width.

    Args:
        width_in: of the page, inches.
        lettered: whether titles begin with (a), (b) ...
    Raises:
        GofError: see `require_figure`.
    """
    columns = max(map(len, rows))
    tile_in = (width_in - GAP_IN * (columns + 1)) / columns
    heights = [_RowHeight.of(row, tile_in) for row in rows]
    height_in = GAP_IN + sum(height.whole for height in heights)
    vector = path.suffix.lower() in VECTOR
    letters = iter("abcdefghijklmnopqrstuvwxyz")

    def draw(figure: Figure) -> None:
        page, top = _Page(figure, width_in, height_in), height_in - GAP_IN
        for row, height in zip(rows, heights, strict=True):
            for column, tile in enumerate(row):
                if tile is None:
                    continue
                left = GAP_IN + column * (tile_in + GAP_IN)
                letter = f"({next(letters, '')}) " if lettered and tile.title else ""
                page.text(left, top - height.title + 0.045, letter + tile.title, LETTERS, most=tile_in)
                page.text(left, top - height.title - height.note + 0.035, tile.note, SMALL, most=tile_in)
                below = top - height.title - height.note - height.picture
                _draw(page.axes(left, below, tile_in, tile_in * _aspect(tile)), tile, vector)
                _legend(page, left, below - 0.03, tile_in, tile.legend)
            top -= height.whole

    Chart("", (width_in, height_in), draw).write(path)


class _RowHeight:
    """Inches of a row's parts."""

    def __init__(self, title: float, note: float, picture: float, legend: float):
        self.title, self.note, self.picture, self.legend = title, note, picture, legend
        self.whole = title + note + picture + legend + GAP_IN

    @classmethod
    def of(cls, row: Row, tile_in: float) -> _RowHeight:
        tiles = [tile for tile in row if tile is not None]
        return cls(
            TITLE_IN if any(tile.title for tile in tiles) else 0.0,
            NOTE_IN if any(tile.note for tile in tiles) else 0.0,
            tile_in * max(map(_aspect, tiles)),
            LEGEND_IN if any(tile.legend for tile in tiles) else 0.0,
        )


def _aspect(tile: Tile) -> float:
    height, width = tile.image.shape[:2]
    return height / width


class _Page:
    """A figure measured in inches from its lower left corner."""

    def __init__(self, figure: Figure, width_in: float, height_in: float):
        self.figure, self.width, self.height = figure, width_in, height_in

    def text(self, x: float, y: float, words: str, size: float, most: float = np.inf, **style) -> None:
        """Words in pt, smaller where they would be wider than `most`."""
        if words:
            size *= min(1.0, ROOM * most / max(text_width_in(words, size), 1e-9))
            self.figure.text(x / self.width, y / self.height, words, fontsize=size, parse_math=False, **style)

    def axes(self, x: float, y: float, width: float, height: float) -> Axes:
        axes = self.figure.add_axes(
            (x / self.width, y / self.height, width / self.width, height / self.height), frameon=False
        )
        axes.set_axis_off()
        return axes


def _draw(axes: Axes, tile: Tile, vector: bool) -> None:
    height, width = tile.image.shape[:2]
    # Pixel edges at whole numbers, as our cameras have them. "none": a PDF keeps the picture's own pixels.
    axes.imshow(
        tile.image, extent=(0, width, height, 0), aspect="auto", interpolation="none" if vector else "antialiased"
    )
    if len(tile.arrows):
        tail, step = tile.arrows[:, 0], tile.arrows[:, 1] - tile.arrows[:, 0]
        axes.quiver(
            *tail.T,
            *step.T,
            angles="xy",
            scale_units="xy",
            scale=1,
            color="white",
            width=0.0045,
            headwidth=4,
            headlength=4.5,
            headaxislength=4,
            minlength=0,
        )
    if tile.outline is not None and tile.outline.any() and not tile.outline.all():
        y, x = np.arange(height) + 0.5, np.arange(width) + 0.5
        axes.contour(x, y, tile.outline.astype(float), [0.5], colors=["white"], linewidths=0.5)
    for number, box in enumerate(tile.boxes):
        axes.plot(*_around(box.x, box.y, box.width, box.height), color=_box_colour(number), linewidth=0.9)
    if tile.frame is not None:
        axes.plot(*_around(0, 0, width, height), color=_box_colour(tile.frame), linewidth=2.4)
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)


def _around(x: float, y: float, width: float, height: float) -> tuple[list[float], list[float]]:
    return [x, x + width, x + width, x, x], [y, y, y + height, y + height, y]


def _box_colour(number: int) -> str:
    return BOX_COLOURS[number % len(BOX_COLOURS)]


def _legend(page: _Page, x: float, y: float, width: float, legend: Bar | Wheel | None) -> None:
    """Below a tile whose lower edge is at y."""
    if isinstance(legend, Bar):
        bar = page.axes(x, y - 0.07, width, 0.07)
        bar.imshow(legend.colours[None], extent=(0, 1, 0, 1), aspect="auto", interpolation="nearest")
        middle = np.sqrt(legend.low * legend.high) if legend.log else (legend.low + legend.high) / 2
        ends = (f"{legend.low:.3g}", f"{middle:.3g}", f"{legend.high:.3g}")
        for share, words, side in zip((0, 0.5, 1), ends, ("left", "center", "right"), strict=True):
            page.text(x + share * width, y - 0.165, words, SMALL, ha=side)
        page.text(x + width / 2, y - 0.26, legend.unit, SMALL, ha="center")
    elif isinstance(legend, Wheel):
        wheel = page.axes(x, y - WHEEL_IN, WHEEL_IN, WHEEL_IN)
        wheel.imshow(wheel_picture(128), interpolation="antialiased")
        page.text(x + WHEEL_IN + 0.05, y - 0.12, f"0 to {legend.longest:.3g} {legend.unit}", SMALL)
        page.text(x + WHEEL_IN + 0.05, y - 0.23, "hue: direction", SMALL)
