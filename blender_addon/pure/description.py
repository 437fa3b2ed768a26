"""dataset.json: what a finished dataset says of itself. `gof.core.description` is the library's own form of it."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal

from ..core.checked_json import require
from .io import FileFormatError
from .io.files import is_name, is_pattern, is_relative_path
from .io.records import read_record, write_record

FILE = "dataset.json"
TEST_EVERY, TEST_FIRST = 8, 4  # every 8th frame is held out (paper, "Results"), from the fifth on


@dataclass(frozen=True)
class Splits:
    """Frame numbers, each in increasing order: what a method may learn from, and what it is scored on."""

    train: tuple[int, ...]
    test: tuple[int, ...]


def held_out(count: int) -> Splits:
    """The splits of a clip of `count` frames by the paper's rule."""
    test = tuple(range(TEST_FIRST, count, TEST_EVERY))
    return Splits(tuple(frame for frame in range(count) if frame not in test), test)


@dataclass(frozen=True)
class CameraEntry:
    """One camera. File names are relative to the dataset; patterns hold `{frame:06d}`.

    Attributes:
        K: (3, 3) intrinsics, pixels; pixel centres are at integer + 0.5.
        world_to_camera: (4, 4) pose in OpenCV axes (x right, y down, z forward), metres.
        row_time_s: from the start of one line to that of the next, s.
        readout: direction in the stored picture in which lines follow each other: "down", "up", "left" or "right".
        role: "train", or "eval" for novel views that no method may learn from.
        roll_deg: by how much the camera was turned about its axis; pictures are stored upright.
        rgb: pattern of display sRGB pictures.     static: the same view without fire.
        mask: pattern of pictures, 255 where flame is.     exr: pattern of linear pictures.
        flow: pattern of true optical flow.     board_mask: picture, 255 on the LED board.
        time_s: the camera's own frame times on the dataset clock, s (middle of the first line's exposure).
    """

    name: str
    width: int
    height: int
    K: tuple[tuple[float, ...], ...]
    world_to_camera: tuple[tuple[float, ...], ...]
    row_time_s: float = 0.0
    readout: str = "down"
    role: Literal["train", "eval"] = "train"
    roll_deg: float = 0.0
    rgb: str | None = None
    static: str | None = None
    mask: str | None = None
    exr: str | None = None
    flow: str | None = None
    board_mask: str | None = None
    time_s: tuple[float, ...] | None = None

    def __post_init__(self):
        require(is_name(self.name), "cameras.name", "the plain name of a file", self.name)
        for name, row, expected in (
            ("K[1][0]", self.K[1][:1], (0,)),
            ("K[2]", self.K[2], (0, 0, 1)),
            ("world_to_camera[3]", self.world_to_camera[3], (0, 0, 0, 1)),
        ):
            straight = all(abs(a - b) <= 1e-9 for a, b in zip(row, expected, strict=True))
            require(straight, f"cameras.{name}", " ".join(map(str, expected)), list(row))
        for kind in ("rgb", "static", "mask", "exr", "flow", "board_mask"):
            pattern = getattr(self, kind)
            rule = "the name of a file in the dataset"
            require(pattern is None or is_pattern(pattern), f"cameras.{kind}", rule, pattern)


@dataclass(frozen=True)
class DatasetDescription:
    """dataset.json.

    Attributes:
        name: of the scene.
        time_s: (T,) frame times on the dataset clock, s, strictly increasing.
        cameras: those of role "train" and "eval"; names differ.
        splits: which frames are for training, which are held out.
        velocity: name of the store of true velocities; None for a real capture.
        spec: the scene spec it was generated from, as JSON; None for a real capture.
        effects: names of the effects that were simulated.
        provenance: what made it, in words and numbers.
        made_from: files computed from pictures of this clip -> the frames that went into them; rendered ones are not.
    """

    SCHEMA: ClassVar[str] = "gof-dataset"
    VERSION: ClassVar[int] = 1

    name: str
    time_s: tuple[float, ...]
    cameras: tuple[CameraEntry, ...]
    splits: Splits
    velocity: str | None = None
    spec: dict[str, Any] | None = None
    effects: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    made_from: dict[str, tuple[int, ...]] = field(default_factory=dict)

    def __post_init__(self):
        names = {unicodedata.normalize("NFC", entry.name).casefold() for entry in self.cameras}
        require(len(names) == len(self.cameras), "cameras", "of different names", [e.name for e in self.cameras])
        for name, frames in (("splits.train", self.splits.train), ("splits.test", self.splits.test)):
            good = all(0 <= k < len(self.time_s) for k in frames) and all(a < b for a, b in pairwise(frames))
            require(good, name, f"frames below {len(self.time_s)} in increasing order", list(frames))
        both = sorted(set(self.splits.train) & set(self.splits.test))
        require(not both, "splits", "of different frames", both)
        inside = self.velocity is None or is_relative_path(self.velocity)
        require(inside, "velocity", "the name of a file in the dataset", self.velocity)

    @classmethod
    def read(cls, folder: Path) -> DatasetDescription:
        """Read `folder/dataset.json`. Raises FileFormatError: absent, of another schema or version, a wrong field."""
        try:
            return read_record(cls, folder / FILE)
        except FileFormatError as error:
            raise FileFormatError(f"{error}; choose the folder of a finished dataset") from None

    def measured_from(self, datum: tuple[float, float, float, float]) -> DatasetDescription:
        """The same cameras and times where the datum, x, y, z (m) and t (s), is the zero of world and clock."""
        cameras = tuple(_measured_from(entry, datum) for entry in self.cameras)
        return replace(self, cameras=cameras, time_s=tuple(time_s - datum[3] for time_s in self.time_s))

    def write(self, folder: Path) -> None:
        """Write `folder/dataset.json`. Written last, it says that the dataset is complete."""
        write_record(folder / FILE, self)


def _measured_from(entry: CameraEntry, datum: tuple[float, float, float, float]) -> CameraEntry:
    turned = [sum(a * x for a, x in zip(row, datum[:3], strict=False)) for row in entry.world_to_camera[:3]]
    rows = [(*row[:3], row[3] + moved) for row, moved in zip(entry.world_to_camera, turned, strict=False)]
    own = entry.time_s and tuple(time_s - datum[3] for time_s in entry.time_s)
    return replace(entry, world_to_camera=(*rows, *entry.world_to_camera[3:]), time_s=own)
