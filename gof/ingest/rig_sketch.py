"""A rough sketch of a rig, in words: where the cameras stand before the flame, when nothing else says it."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from gof.core.errors import GofError
from gof.footage.lens import Lens
from gof.ingest.bundle import Anchor

NUMBERS = ("two", "three", "four", "five", "six", "seven", "eight")  # of cameras, from 2 on
SHAPE = r"(?:(\w+)\s+(?:cameras\s+|phones\s+)?in\s+an?\s+)?(row|arc)"
APART = r"(\d+(?:\.\d+)?)\s*(m|cm|degrees|degree|deg)\s+apart"
SKETCH = re.compile(rf"\s*{SHAPE}\s*,\s*{APART}\s*,\s*(\d+(?:\.\d+)?)\s*(m|cm)\s+away\s*\.?\s*", re.IGNORECASE)
EXAMPLES = '"3 in a row, 0.5 m apart, 2 m away" or "3 in an arc, 35 degrees apart, 2 m away"'
WIDEST_DEG = 180.0  # from the first to the last camera of an arc: then they look at each other
# How far a sketch may be off: standard deviations.
PLACE = 0.2  # of the distance between neighbours
SIDEWAYS = 0.2  # of the angle between neighbours, as the flame's distance is guessed
TILTED_DEG, ROLLED_DEG = 5.0, 5.0


@dataclass(frozen=True)
class RigSketch:
    """Cameras in a row or on an arc, evenly apart, at one height, that all look at the flame's middle.

    Attributes:
        words: as a person wrote it.
        count: of cameras; None: not stated.
        apart: between neighbours: metres in a row, degrees on an arc, as seen from the flame.
        away_m: from the flame to the middle of the row, or to the arc.
        is_arc: whether it is an arc.
    """

    words: str
    count: int | None
    apart: float
    away_m: float
    is_arc: bool

    @classmethod
    def parse(cls, words: str) -> RigSketch | None:
        """Read a sketch; None where the text is none.

        Raises:
            GofError: a sketch whose numbers make no rig.
        """
        found = SKETCH.fullmatch(words)
        if found is None:
            return None
        number, shape, apart, unit, away, away_unit = (part and part.lower() for part in found.groups())
        is_arc = unit.startswith("deg")
        if is_arc != (shape == "arc"):
            raise GofError(f"--rig '{words}': a row has metres between its cameras, an arc degrees, as {EXAMPLES}")
        count = None if number is None else int(number) if number.isdecimal() else _number(number)
        if number is not None and (count is None or count < 2):
            raise GofError(f"--rig '{words}': '{number}' is no number of cameras; write it as {EXAMPLES}")
        metres = {"m": 1.0, "cm": 0.01}
        sketch = cls(
            words.strip(), count, float(apart) * metres.get(unit, 1.0), float(away) * metres[away_unit], is_arc
        )
        if sketch.apart <= 0 or sketch.away_m <= 0:
            raise GofError(f"--rig '{words}': cameras stand apart from each other, and away from the flame")
        return sketch

    def centres(self, count: int) -> np.ndarray:
        """Return (C, 3) where `count` cameras stand, metres; the flame's middle is the origin, z is up, and the first
        camera is on the left, as they see it.

        Raises:
            GofError: it is for another number of cameras; they would stand around the flame.
        """
        if count < 2 or (self.count is not None and self.count != count):
            raise GofError(f"--rig '{self.words}': there are {count} videos; a sketch is for two cameras or more")
        step = np.arange(count) - (count - 1) / 2
        if not self.is_arc:
            return np.stack([step * self.apart, np.full(count, -self.away_m), np.zeros(count)], 1)
        if self.apart * (count - 1) >= WIDEST_DEG:
            raise GofError(f"--rig '{self.words}': less than {WIDEST_DEG:g} degrees from the first camera to the last")
        angle = np.deg2rad(self.apart) * step
        return self.away_m * np.stack([np.sin(angle), -np.cos(angle), np.zeros(count)], 1)

    def poses(self, lenses: list[Lens], middles: np.ndarray, opposite: bool = False) -> np.ndarray:
        """Return (C, 4, 4) world to camera, held level, but turned so that each sees the flame's middle at the pixel
        middles (C, 2).

        Args:
            opposite: the first camera stands on the right.

        Raises GofError as `centres`.
        """
        centres = self.centres(len(lenses))[:: -1 if opposite else 1]
        return np.array([_looking(c, lens, px) for c, lens, px in zip(centres, lenses, middles, strict=True)])

    def anchor(self, poses: np.ndarray) -> Anchor:
        """Return how far cameras may be from these poses (C, 4, 4) of the sketch."""
        centres = self.centres(len(poses))
        step = float(np.linalg.norm(centres[1] - centres[0]))  # positive: both are checked when it is read
        turn = np.array([np.deg2rad(TILTED_DEG), np.arctan(SIDEWAYS * step / self.away_m), np.deg2rad(ROLLED_DEG)])
        return Anchor(poses, turn, np.full(3, PLACE * step))


def _number(word: str) -> int | None:
    return NUMBERS.index(word) + 2 if word in NUMBERS else None


def _looking(centre: np.ndarray, lens: Lens, middle: np.ndarray) -> np.ndarray:
    """Return (4, 4) of a level camera at a place (3,) off the z axis, turned so that pixel (2,) shows the origin."""
    from scipy.spatial.transform import Rotation  # here: it takes long to load

    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)  # sketches are level: never straight up
    level = np.stack([right, np.cross(forward, right), forward])
    ray = np.linalg.solve(lens.K, [*middle, 1.0])
    pan, tilt = np.arctan2(ray[0], np.hypot(ray[1], ray[2])), np.arctan2(-ray[1], ray[2])
    pose = np.eye(4)
    # Turned about the vertical, then tilted about its own x axis: it stays level, and its ray to the origin is `ray`.
    turned = Rotation.from_euler("X", tilt).as_matrix() @ Rotation.from_euler("Y", pan).as_matrix()
    pose[:3, :3] = turned @ level
    pose[:3, 3] = -pose[:3, :3] @ centre
    return pose
