"""The tiles of a printed figure: a picture with its title, its legend in physical units, and what is drawn over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from gof.evaluate.screen_motion import ScreenVelocity
from gof.look.images import INFERNO, VIRIDIS, ramp, to_bytes
from gof.look.panels import MOST_ERROR, Scales, depth_colours, error_colours
from gof.look.velocity import GROUND, arrows, colours

BOX_COLOURS = ("#22d3ee", "#facc15", "#a3e635", "#f472b6")  # of the first box, the second ...
NO_ARROWS = np.zeros((0, 2, 2))


@dataclass(frozen=True)
class Bar:
    """A colour bar.

    Attributes:
        low, high: values of its first and last colour.   unit: of them.
        colours: (256, 3) display values.   log: whether equal steps are equal ratios.
    """

    low: float
    high: float
    unit: str
    colours: np.ndarray
    log: bool = False


@dataclass(frozen=True)
class Wheel:
    """The colour wheel of directions; full brightness is `longest` of the unit."""

    longest: float
    unit: str


class Box(NamedTuple):
    """Part of a picture: upper left corner and size in whole px."""

    x: int
    y: int
    width: int
    height: int

    def of(self, image: np.ndarray) -> np.ndarray:
        return image[self.y : self.y + self.height, self.x : self.x + self.width]


@dataclass(frozen=True)
class Tile:
    """One picture of a figure.

    Attributes:
        image: (H, W, 3) uint8.
        title: what it is.   note: a figure about it, below the title.
        legend: what its colours mean; None for pictures.
        arrows: (A, 2, 2) tails and heads in px (x, y).
        boxes: parts that other tiles show enlarged, the first in the first colour.
        outline: (H, W) bool, whose edge is drawn as a line.
        frame: number of the box that this tile shows, None for whole pictures.
    """

    image: np.ndarray
    title: str = ""
    note: str = ""
    legend: Bar | Wheel | None = None
    arrows: np.ndarray = field(default_factory=lambda: NO_ARROWS)
    boxes: tuple[Box, ...] = ()
    outline: np.ndarray | None = None
    frame: int | None = None


Row = Sequence[Tile | None]  # of a figure; None leaves a place empty


def facts(rows: Sequence[Row]) -> dict[str, list]:
    """Return a figure's tiles and the meaning of their colours, for a JSON file."""
    return {"tiles": [[tile and _fact(tile) for tile in row] for row in rows]}


def _fact(tile: Tile) -> dict:
    fact: dict[str, Any] = {"title": tile.title, "note": tile.note, "size": list(tile.image.shape[1::-1])}
    if tile.boxes:
        fact["boxes"] = [list(box) for box in tile.boxes]
    if isinstance(tile.legend, Bar):
        fact |= {"low": tile.legend.low, "high": tile.legend.high, "unit": tile.legend.unit}
    elif tile.legend:
        fact |= {"longest": tile.legend.longest, "unit": tile.legend.unit}
    return fact


def picture_tile(image: np.ndarray, title: str, note: str = "") -> Tile:
    """Make a tile of display values (H, W, 3)."""
    return Tile(to_bytes(image[..., :3]), title, note)


def velocity_tile(velocity: ScreenVelocity, title: str, longest: float, unit: str, note: str = "") -> Tile:
    """Return direction as hue, speed as brightness, and arrows; `longest` has full brightness."""
    return Tile(colours(velocity, longest), title, note, Wheel(longest, unit), arrows(velocity, longest))


def depth_tile(depth: np.ndarray, title: str, near: float, far: float, unit: str, note: str = "") -> Tile:
    """Make a tile of (H, W) depth: near yellow, far violet, by its logarithm; what is not finite is dark."""
    known = np.isfinite(depth)
    image = depth_colours(np.where(known, depth, far), known.astype(float), Scales(1.0, near, far))
    return Tile(image, title, note, Bar(near, far, unit, ramp(VIRIDIS)[::-1] / 255, log=True))


def error_tile(drawn: np.ndarray, recorded: np.ndarray, title: str, note: str = "", most: float = MOST_ERROR) -> Tile:
    """Make a tile of two pictures (H, W, 3), display values: the mean difference of their channels, up to `most`."""
    image = error_colours(to_bytes(drawn[..., :3]), to_bytes(recorded[..., :3]), most)
    return Tile(image, title, note, Bar(0.0, most, "of display values", ramp(INFERNO) / 255))


def dimmed(image: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Display values (H, W, 3) where `share` (H, W) is 1, the dark ground where it is 0."""
    return share[..., None] * image + (1 - share[..., None]) * GROUND
