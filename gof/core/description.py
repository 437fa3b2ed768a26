"""dataset.json: what a dataset says of itself. The one place of the library that knows its fields (docs/formats.md)."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from .cameras import Camera, bent_by
from .datum import Datum
from .errors import DataFormatError
from .files import is_relative_path, read_json
from .records import from_json, write_record

FILE = "dataset.json"
FRAME = re.compile(r"\{frame(?::0?([1-9])d)?\}")  # all of Python's format language that file names may use
PICTURES = ("rgb", "static", "mask", "exr", "flow", "board_mask")  # fields of a camera that name files
METRES = "metres"  # how provenance["scale"] begins, if it is there at all, where lengths are metres
Row3 = tuple[float, float, float]
Row4 = tuple[float, float, float, float]
TEST_EVERY, TEST_FIRST = 8, 4  # every 8th frame is held out (paper, "Results"), from the fifth on


@dataclass(frozen=True)
class Splits:
    """Frame numbers, each in increasing order: what a method may learn from, and what it is scored on."""

    train: tuple[int, ...]
    test: tuple[int, ...]


def held_out(count: int, first: int = TEST_FIRST) -> Splits:
    """Return the splits of a clip of `count` frames by the paper's rule; `first` is the first frame that is held
    out."""
    test = tuple(range(first, count, TEST_EVERY))
    return Splits(tuple(k for k in range(count) if k not in test), test)


@dataclass(frozen=True)
class CameraEntry:
    """One camera of dataset.json. File names are relative to the dataset; patterns hold `{frame:06d}`.

    Attributes:
        name, width, height, K, world_to_camera, row_time_s, readout: see `gof.core.cameras.Camera`.
        role: "train", or for views that no method may learn from: "eval" for novel ones, and "around" for those from
            all sides, of a few frames.
        roll_deg: by how much the camera was turned about its axis; pictures are stored upright.
        rgb: pattern of display sRGB pictures.     static: the same view without fire.
        mask: pattern of pictures, 255 where flame is.     exr: pattern of linear pictures.
        flow: pattern of true optical flow.
        board_mask: picture, 255 on the LED board.
        time_s: the camera's own frame times on the dataset clock, s; None = the dataset's.
        frames: numbers of the frames that it has pictures of, in increasing order; None = all.
    """

    name: str
    width: int
    height: int
    K: tuple[Row3, Row3, Row3]
    world_to_camera: tuple[Row4, Row4, Row4, Row4]
    row_time_s: float = 0.0
    readout: str = "down"
    role: Literal["train", "eval", "around"] = "train"
    roll_deg: float = 0.0
    rgb: str | None = None
    static: str | None = None
    mask: str | None = None
    exr: str | None = None
    flow: str | None = None
    board_mask: str | None = None
    time_s: tuple[float, ...] | None = None
    frames: tuple[int, ...] | None = None

    @classmethod
    def of(cls, camera: Camera, **fields: Any) -> CameraEntry:
        """Return the entry of a camera; `fields` are those that a `Camera` does not have."""
        return cls(**camera.to_dict(), **fields)

    def file_name(self, kind: str, frame: int = 0) -> str | None:
        """Name of a file, relative to the dataset; `kind` is one of PICTURES. None when there are no such files."""
        pattern = getattr(self, kind)
        return None if pattern is None else FRAME.sub(lambda m: f"{frame:0{m[1] or 1}d}", pattern)

    def measured_from(self, datum: Datum) -> CameraEntry:
        """Return the same camera where the datum is the zero of world and clock."""
        own = self.time_s and tuple(time_s - datum.time_s for time_s in self.time_s)
        a, b, c, d = map(tuple, self.camera().measured_from(datum).world_to_camera.tolist())
        return replace(self, world_to_camera=(a, b, c, d), time_s=own)

    def camera(self) -> Camera:
        """Return its camera. Raises DataFormatError or NonFiniteError: the matrices are not a camera's."""
        K, world_to_camera = np.array(self.K), np.array(self.world_to_camera)
        return Camera(self.name, self.width, self.height, K, world_to_camera, self.row_time_s, self.readout)


@dataclass(frozen=True)
class DatasetDescription:
    """dataset.json.

    Attributes:
        name: of the scene or the capture.
        time_s: (T,) frame times on the dataset clock, s, strictly increasing.
        cameras: those of role "train", "eval" and "around"; names differ.
        splits: which frames are for training, which are held out.
        velocity: name of the store of true velocities; None for a real capture.
        spec: the scene spec it was generated from, as JSON; None for a real capture.
        effects: names of the effects that were simulated.
        provenance: what made it, in words and numbers.
        made_from: files that were computed from pictures of this clip (plates, depth, poses), each with the numbers of
            the frames that went into it; see `gof.dataset.leaks`. A mask of a frame, for scores only, is not listed.

    Raises:
        DataFormatError, NonFiniteError: times do not increase, a camera's own times have another length, a split names
            a frame there is not, or one twice, a frame is in both splits, two cameras share a name (in any case and any
            form of its letters), no camera is for training, a matrix is not a camera's, or a name of a file leads out
            of the dataset.
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

    @property
    def in_metres(self) -> bool:
        """Whether lengths are metres; poses solved without any known length have a unit of their own, and say so."""
        return str(self.provenance.get("scale", METRES)).startswith(METRES)

    @property
    def datum(self) -> Datum:
        """Return the datum of places and times for computing in float32; zeros where the dataset lies near
        zero."""
        centres = [camera.position for camera in self.cameras_from(Datum(), "train")]
        return Datum.of(np.array(centres), np.array(self.time_s))

    def cameras_from(self, datum: Datum, *roles: str) -> list[Camera]:
        """Return the cameras of these roles, in file order, measured from the datum."""
        return [entry.camera().measured_from(datum) for entry in self.cameras if entry.role in roles]

    def measured_from(self, datum: Datum) -> DatasetDescription:
        """Return the same cameras and times where the datum is the zero of world and clock."""
        return replace(
            self,
            cameras=tuple(entry.measured_from(datum) for entry in self.cameras),
            time_s=tuple(time_s - datum.time_s for time_s in self.time_s),
        )

    @property
    def is_filmed(self) -> bool:
        """Whether its pictures are footage of a real fire, of which no motion is known; False for a simulated one."""
        return not self.spec and self.velocity is None

    def __post_init__(self):
        count = len(self.time_s)
        if not _increasing(self.time_s):
            raise DataFormatError("time_s must be a non-empty, strictly increasing list of seconds")
        if not any(entry.role == "train" for entry in self.cameras):
            raise DataFormatError("no camera with role 'train'")
        if len({_as_file_system(entry.name) for entry in self.cameras}) < len(self.cameras):
            raise DataFormatError("two cameras have the same name, in any case and any form of its letters")
        for name, frames in (("train", self.splits.train), ("test", self.splits.test)):
            if not all(0 <= k < count for k in frames):
                raise DataFormatError(f"splits.{name} must list frame numbers below {count}")
            if any(a >= b for a, b in pairwise(frames)):
                raise DataFormatError(f"splits.{name} must list frames in increasing order, each once")
        if both := sorted(set(self.splits.train) & set(self.splits.test)):
            raise DataFormatError(
                f"splits: frames {both[:5]} are in train and in test; a frame is held out or it is not"
            )
        for entry in self.cameras:
            entry.camera()  # or it says what is wrong
            for kind in PICTURES:
                _require_inside(f"camera '{entry.name}': {kind}", getattr(entry, kind))
            if entry.time_s is not None and not (len(entry.time_s) == count and _increasing(entry.time_s)):
                raise DataFormatError(
                    f"camera '{entry.name}': time_s must hold {count} strictly increasing seconds, one per frame"
                )

            if entry.frames is not None and (
                entry.role == "train"
                or not all(0 <= k < count for k in entry.frames)
                or any(a >= b for a, b in pairwise(entry.frames))
            ):
                raise DataFormatError(
                    f"camera '{entry.name}': frames must list numbers below {count} in increasing order, each once; "
                    "a camera to train on has them all"
                )
        _require_inside("velocity", self.velocity)

    @classmethod
    def read(cls, folder: Path) -> DatasetDescription:
        """Read `folder/dataset.json`.

        Raises:
            DataFormatError: absent, another schema or version, a wrong field (names it).
        """
        path = folder / FILE
        if not path.is_file():
            within = sorted(folder.glob(f"*/{FILE}")) if folder.is_dir() else []
            remedy = (
                f"it is in {within[0].parent}: give that folder"
                if within
                else "not a dataset, or not finished: run the 'gof generate' or 'gof ingest' that makes it again"
            )
            raise DataFormatError(f"{folder}: no {FILE}; {remedy}")
        data = read_json(path)
        entries = data.get("cameras") if isinstance(data, dict) else None
        for entry in entries if isinstance(entries, list) else ():
            if isinstance(entry, dict) and (bent := bent_by(entry)):
                raise DataFormatError(
                    f"{path}: camera {str(entry.get('name'))[:80]!r} has {', '.join(bent)}: distortion, which a "
                    "dataset's pictures have not: undistort them"
                )
        return from_json(cls, data, path)

    def write(self, folder: Path) -> None:
        """Write `folder/dataset.json`. Written last, it says that the dataset is complete."""
        write_record(folder / FILE, self)


def dataset_folder(path: Path) -> Path:
    """Return the folder of a dataset, also where its dataset.json is named."""
    return path.parent if path.name == FILE and path.is_file() else path


def _as_file_system(name: str) -> str:
    """Return a key, equal for names of one file on systems that mind neither case nor the form of letters."""
    return unicodedata.normalize("NFC", name).casefold()


def _require_inside(field_name: str, path: str | None) -> None:
    """Require a name of a file in the dataset, or a pattern of such names."""
    if path is not None and not is_relative_path(FRAME.sub("0", path)):
        raise DataFormatError(f"{field_name}: {path[:80]!r} cannot be the name of a file in the dataset")


def _increasing(values: tuple[float, ...]) -> bool:
    times = np.asarray(values, np.float64)
    return bool(len(times)) and bool(np.isfinite(times).all()) and bool((np.diff(times) > 0).all())
