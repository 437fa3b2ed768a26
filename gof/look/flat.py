"""Tiles for pages on a screen: one picture each with all that is drawn over it, and its words beside."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import cv2
import numpy as np
from PIL import ImageColor

from gof.core.errors import GofError
from gof.evaluate.leaderboard import EvaluatedResult
from gof.look.animation import data_uri, enlarge, factor_for
from gof.look.comparison import Moment, comparison, scored_subject
from gof.look.leaderboard_page import PageGrid, PagePicture
from gof.look.tiles import BOX_COLOURS, Bar, Row, Tile, Wheel

WIDEST = 480  # px that a page shows of a picture


def page_pictures(rows: Sequence[Row]) -> list[list[PagePicture | None]]:
    """The tiles of a figure for a page."""
    return [[tile and PagePicture(data_uri(flat(tile)), tile.title, in_words(tile)) for tile in row] for row in rows]


def side_by_side(results: Sequence[EvaluatedResult], moment: Moment) -> PageGrid | None:
    """The results that can be read again, each drawn as it was scored; None where there is none."""
    subjects = []
    for result in results:
        with suppress(GofError):  # pages name those that are gone or damaged beside their scores
            subjects.append(scored_subject(result, moment))
    return PageGrid(page_pictures(comparison(subjects, moment)), moment.in_words) if subjects else None


def in_words(tile: Tile) -> str:
    """The tile's note, and what its colours mean."""
    legend = tile.legend
    if isinstance(legend, Bar):
        said = f"colours: {legend.low:.3g} to {legend.high:.3g} {legend.unit}"
    else:
        said = f"full brightness: {legend.longest:.3g} {legend.unit}" if isinstance(legend, Wheel) else ""
    return "; ".join(filter(None, (tile.note, said)))


def flat(tile: Tile) -> np.ndarray:
    """(H, W, 3) uint8 with arrows, outline and boxes in it, small pictures enlarged, large ones reduced."""
    width = tile.image.shape[1]
    factor = factor_for(width)
    image = np.array(enlarge(tile.image, factor))  # one that may be written to
    for tail, head in tile.arrows * factor:
        ends = [tuple(round(16 * c) for c in end.tolist()) for end in (tail, head)]  # 1/16 px
        cv2.arrowedLine(image, *ends, (255, 255, 255), 1, cv2.LINE_AA, shift=4, tipLength=0.35)
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
    return ImageColor.getrgb(BOX_COLOURS[number % len(BOX_COLOURS)])
