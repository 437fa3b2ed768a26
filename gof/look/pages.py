"""Parts that pages share: templates, and tiles as one picture each with all that is drawn over it and words beside."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from PIL import ImageColor

from gof.core.errors import GofError
from gof.evaluate.leaderboard import EvaluatedResult
from gof.host.threads import map_on_cores
from gof.look.comparison import Moment, comparison, scored_subject
from gof.look.images import base64_text, data_uri, enlarge, factor_for
from gof.look.tiles import BOX_COLOURS, Bar, Row, Tile, Wheel

if TYPE_CHECKING:
    from jinja2 import Template

WIDEST = 480  # px that a page shows of a picture


def template(name: str) -> Template:
    """Return a template of this room; what is not there is an error, and what comes in is text unless marked safe."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("gof.look", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["duration"] = duration
    environment.filters["hash"] = source_hash
    return environment.get_template(name)


def source_hash(text: str) -> str:
    """Return a script or a style as a Content-Security-Policy names it."""
    return f"sha256-{base64_text(hashlib.sha256(text.encode()).digest())}"


def duration(seconds: float) -> str:
    """Return seconds in words."""
    return f"{seconds:.1f} s" if seconds < 100 else f"{int(seconds // 60)} min {int(seconds % 60)} s"


@dataclass(frozen=True)
class PagePicture:
    """A picture of a page as a data URI, with what stands above it and below."""

    uri: str
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class PageGrid:
    """Results side by side: rows of pictures, None where a place is empty; `of` which camera and frame they are."""

    rows: Sequence[Sequence[PagePicture | None]]
    of: str


def page_pictures(rows: Sequence[Row]) -> list[list[PagePicture | None]]:
    """Return the tiles of a figure for a page."""

    def of(tile: Tile | None) -> PagePicture | None:
        return None if tile is None else PagePicture(data_uri(flat(tile)), tile.title, in_words(tile))

    return [map_on_cores(of, row) for row in rows]


def side_by_side(results: Sequence[EvaluatedResult], moment: Moment) -> PageGrid | None:
    """Return the results that can be read again, each drawn as it was scored; None where there is none."""
    subjects = []
    for result in results:
        with suppress(GofError):  # pages name those that are gone or damaged beside their scores
            subjects.append(scored_subject(result, moment))
    return PageGrid(page_pictures(comparison(subjects, moment)), moment.in_words) if subjects else None


def in_words(tile: Tile) -> str:
    """Return the tile's note, and what its colours mean."""
    legend = tile.legend
    if isinstance(legend, Bar):
        meaning = f"colours: {legend.low:.3g} to {legend.high:.3g} {legend.unit}"
    else:
        meaning = f"full brightness: {legend.longest:.3g} {legend.unit}" if isinstance(legend, Wheel) else ""
    return "; ".join(filter(None, (tile.note, meaning)))


def flat(tile: Tile) -> np.ndarray:
    """Return (H, W, 3) uint8 with arrows, outline and boxes in it, small pictures enlarged, large ones reduced."""
    width = tile.image.shape[1]
    factor = factor_for(width)
    image = np.array(enlarge(tile.image, factor))  # one that may be written to
    for tail, head in tile.arrows * factor:
        begin, end = ([round(16 * c) for c in end.tolist()] for end in (tail, head))  # 1/16 px
        cv2.arrowedLine(image, begin, end, (255, 255, 255), 1, cv2.LINE_AA, shift=4, tipLength=0.35)
    if tile.outline is not None:
        edges, _ = cv2.findContours(
            cv2.resize(tile.outline.astype(np.uint8), image.shape[1::-1], interpolation=cv2.INTER_NEAREST),
            cv2.RETR_LIST,
            cv2.CHAIN_APPROX_NONE,
        )
        cv2.drawContours(image, edges, -1, (255, 255, 255), 1)
    for number, box in enumerate(tile.boxes):
        low, high = (box.x * factor, box.y * factor), ((box.x + box.width) * factor, (box.y + box.height) * factor)
        cv2.rectangle(image, low, high, _colour(number), max(2, factor))
    if tile.frame is not None:
        size = image.shape[1] - 1, image.shape[0] - 1
        cv2.rectangle(image, (0, 0), size, _colour(tile.frame), max(4, image.shape[1] // 40))
    if image.shape[1] > WIDEST:
        size = WIDEST, round(image.shape[0] * WIDEST / image.shape[1])
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return image


def _colour(number: int) -> tuple[int, int, int]:
    red, green, blue, *_ = ImageColor.getrgb(BOX_COLOURS[number % len(BOX_COLOURS)])
    return red, green, blue
