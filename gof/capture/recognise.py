"""Recognise the board from the footage: a board's lights must lie where its template has them.

Boards may share a marker: what blinks beside it, in marker sides, tells them apart. A board that is named is believed
only as far as the footage agrees: the counter of a wrong board gives times that are wrong by half a minute.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from gof.capture.locate import (
    MARKER_CORNERS,
    BoardNotFound,
    MarkerNotFound,
    Summary,
    bright_spots,
    find_marker,
    project,
)
from gof.capture.ring_board import RING_BOARDS, RingBoard, load_board
from gof.capture.ring_signals import find_board, read_frame
from gof.capture.template import BUILT_IN, BoardTemplate
from gof.core.errors import GofError
from gof.footage.videos import distinct_names, stored_frames

AUTO = "auto"
LOOK_AT = 160  # frames
RING_FRAMES = 8  # of them, in which a ring board is looked for: it may be carried about
REACH = 0.15  # marker sides around a light's place in which it is looked for: a third of their spacing
FEWEST_LIGHTS = 4
MOST_OFF, CORNERS_PX = 0.05, 0.5  # marker sides, plus the marker's corners: own boards 0.04, others 0.07 to 0.12
CLEARLY = 0.7  # of another board's distance: a board that is nearer than that is the one
LIT = 25.0  # grey levels of a ring's LED above the board

Board = BoardTemplate | RingBoard


class BoardUnclear(GofError):
    """A board's marker was found, but the footage does not show which board it belongs to."""


@dataclass(frozen=True)
class _Likeness:
    """The evidence of one camera's footage for a board.

    Attributes:
        lights: how many were seen near their places.
        off: by how many marker sides they lie beside them, median.   most: up to where they are believed.
    """

    lights: int
    off: float
    most: float

    @property
    def fits(self) -> bool:
        return self.lights >= FEWEST_LIGHTS and self.off <= self.most


def known_boards() -> list[Board]:
    """Return every built-in board."""
    return [load_board(name) for name in (*BUILT_IN, *RING_BOARDS)]


def recognise(choice: str, footage: Mapping[str, Iterable[np.ndarray]], rings: bool = True) -> Board | None:
    """Return the board that the footage shows, by the cameras that see its whole marker.

    Args:
        choice: "auto", or the name or file of a board that the user names.
        footage: each camera's frames, RGB or grey, by its name; the first ones are looked at.
        rings: whether to look for ring boards too.
    Returns:
        None where the choice is "auto" and no camera shows a board.
    Raises:
        GofError: the footage shows another board than the chosen one, or several boards.
        BoardUnclear: the choice is "auto", and the footage does not show which board it is.
        DataFormatError: the chosen file is no board.
    """
    chosen = None if choice == AUTO else load_board(choice)
    boards = [board for board in known_boards() if rings or isinstance(board, BoardTemplate)]
    if chosen is not None:
        boards = [chosen, *(board for board in boards if board.name != chosen.name)]
    likeness: dict[str, dict[str, _Likeness]] = {}
    for camera, frames in footage.items():
        try:
            likeness[camera] = _compare(frames, boards)
        except GofError:  # who reads the footage to its end says what is wrong with it
            likeness[camera] = {}
    verdicts = {camera: _verdict(found, boards) for camera, found in likeness.items()}
    seen = {camera: board for camera, board in verdicts.items() if board is not None}
    if len({board.name for board in seen.values()}) > 1:
        listed = ", ".join(f"{camera} {board.name}" for camera, board in seen.items())
        raise GofError(f"the cameras show different boards ({listed}): their clocks have nothing in common")
    found = next(iter(seen.values()), None)
    if chosen is not None:
        _require_chosen(chosen, found, likeness)
        return chosen
    if found is None and any(likeness.values()):
        raise BoardUnclear(
            f"a board's marker was found, but not which board it belongs to: {_evidence(likeness)}. Is it running, "
            f"sharp, and near enough? Else name it with --board ({', '.join(b.name for b in boards)}, or its JSON file)"
        )
    return found


def _compare(frames: Iterable[np.ndarray], boards: list[Board]) -> dict[str, _Likeness]:
    """Return one camera's footage with every board whose marker it shows, by the board's name."""
    summary = Summary()
    pictures: list[np.ndarray] = []
    for count, frame in enumerate(islice(frames, LOOK_AT)):
        summary.add(frame)
        if count % (LOOK_AT // RING_FRAMES) == 0 or len(pictures) < 2:
            pictures.append(frame)
    found: dict[str, _Likeness] = {}
    if summary.count == 0:
        return found
    markers: dict[tuple[int, bool], np.ndarray | None] = {}
    for board in boards:
        marker = (board.marker_id, board.inverted)
        if isinstance(board, RingBoard):
            likeness = _ring_likeness(pictures, board)
        else:
            if marker not in markers:
                markers[marker] = _corners(summary, board)
            corners = markers[marker]
            likeness = None if corners is None else _strip_likeness(summary, board, corners)
        if likeness is not None:
            found[board.name] = likeness
    return found


def _corners(summary: Summary, board: BoardTemplate) -> np.ndarray | None:
    try:
        return find_marker(summary, board)
    except MarkerNotFound:
        return None


def _strip_likeness(summary: Summary, board: BoardTemplate, corners: np.ndarray) -> _Likeness:
    """Return the lights that blink beside the marker, against the template's LEDs."""
    import cv2

    H, _ = cv2.findHomography(MARKER_CORNERS, corners)
    side = float(np.sqrt(abs(cv2.contourArea(corners.astype(np.float32)))))
    blinks = cv2.GaussianBlur(summary.high - summary.low, (0, 0), max(0.5, side / 60)).astype(np.float32)
    places = project(H, board.led_xy)
    spots, seen = bright_spots(blinks, places, radius=max(2.0, REACH * side))
    off = np.linalg.norm(spots - places, axis=1)[seen] / side
    return _Likeness(int(seen.sum()), float(np.median(off)) if len(off) else np.inf, MOST_OFF + CORNERS_PX / side)


def _ring_likeness(pictures: list[np.ndarray], board: RingBoard) -> _Likeness | None:
    """Return whether LEDs of the ring shine, and others not, in most of the pictures that show its marker."""
    lit = []
    for picture in pictures:
        red = np.ascontiguousarray(picture[..., 0]) if picture.ndim == 3 else picture
        homography = find_board(picture, red, board, None)
        if homography is not None:
            light = read_frame(red, board, homography).led
            lit.append(int((light > LIT).sum()) if np.median(light) < LIT else 0)
    if not lit:
        return None
    shines = np.mean(np.array(lit) > 0) > 0.5
    return _Likeness(max(FEWEST_LIGHTS, max(lit)) if shines else 0, 0.0 if shines else np.inf, MOST_OFF)


def _verdict(likeness: dict[str, _Likeness], boards: list[Board]) -> Board | None:
    """Return the board that fits clearly better than the others; the first of those that lie the same."""
    fitting = [board for board in boards if board.name in likeness and likeness[board.name].fits]
    if not fitting:
        return None
    best = min(fitting, key=lambda board: likeness[board.name].off)
    nearly = [b for b in fitting if likeness[best.name].off > CLEARLY * likeness[b.name].off and _differ(b, best)]
    return None if nearly else best


def _differ(one: Board, other: Board) -> bool:
    """Return whether two boards' lights lie in different places; copies of one template do not."""
    return type(one) is not type(other) or not (
        one.led_xy.shape == other.led_xy.shape and np.allclose(one.led_xy, other.led_xy, atol=1e-3)
    )


def _require_chosen(chosen: Board, found: Board | None, likeness: dict[str, dict[str, _Likeness]]) -> None:
    """Raise GofError where the footage speaks against the board that was named."""
    if found is not None and found is not chosen and _differ(found, chosen):
        raise GofError(
            f"--board {chosen.name}: the footage shows board '{found.name}' ({_evidence(likeness)}); leave --board out"
        )
    own = [found[chosen.name] for found in likeness.values() if chosen.name in found]
    judged = [one for one in own if one.lights >= FEWEST_LIGHTS]
    if judged and not any(one.fits for one in judged):
        raise GofError(
            f"--board {chosen.name}: its marker is there, but the lights are not where it has them "
            f"({_evidence(likeness)}). Is it another board, or does its file not say where its LEDs are?"
        )


def _evidence(likeness: dict[str, dict[str, _Likeness]]) -> str:
    """Return every camera's findings about every board, in words."""
    findings = []
    for camera, found in likeness.items():
        each = [
            f"{one.lights} lights lie {one.off:.2f} marker sides beside those of {name}"
            if np.isfinite(one.off)
            else f"no light where {name} has them"
            for name, one in found.items()
        ]
        findings.append(f"{camera}: {', '.join(each) or 'no marker'}")
    return "; ".join(findings)


def require_strips(board: Board | None, for_what: str) -> BoardTemplate:
    """Return the board, for those who read strips. Raises BoardNotFound: there is none, or it is a ring board."""
    if isinstance(board, BoardTemplate):
        return board
    if board is None:
        raise BoardNotFound(
            "no camera shows the marker of an LED board: is it whole, lit, and at least about 20 pixels wide?"
        )
    raise BoardNotFound(f"'{board.name}' is a ring board, which gives times only; {for_what} needs a board with strips")


# ----------------------------------------------------------------
# The first frames of the footage of each camera, in which a board is recognised.


def first_frames(videos: list[Path]) -> dict[str, Iterable[np.ndarray]]:
    """Return each video's first frames, read when needed, by the camera's name."""
    return dict(zip(distinct_names(videos), (islice(stored_frames(video), LOOK_AT) for video in videos), strict=True))
