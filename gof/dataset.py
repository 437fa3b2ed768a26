"""The on-disk dataset: what the generator writes and everything else reads (layout in docs/formats.md)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gof.cameras import Camera
from gof.errors import DataFormatError
from gof.fields import VelocitySequence
from gof.io.files import read_json

SCHEMA, VERSION = "gof-dataset", 1
_REQUIRED = ("name", "time_s", "cameras", "splits")
FRAME = re.compile(r"\{frame(?::0?([1-9])d)?\}")  # all of Python's format language that file names may use


@dataclass(frozen=True)
class Dataset:
    """A capture or a benchmark scene. Frames and cameras are numbered from 0; images are read when asked for.

    Attributes:
        path: the folder.
        meta: the content of dataset.json.
        cameras: the reconstruction's cameras (role "train"), in file order.
        times_s: (T,) float64 frame times on the dataset clock.
    """

    path: Path
    meta: dict[str, Any]
    cameras: list[Camera]
    times_s: np.ndarray

    @classmethod
    def open(cls, folder: str | Path) -> Dataset:
        """Read `folder/dataset.json`.

        Raises:
            DataFormatError: no dataset there, another schema or version, a missing or malformed field.
        """
        folder = Path(folder)
        source = folder / "dataset.json"
        if not source.is_file():
            raise DataFormatError(
                f"{folder}: no dataset.json; not a dataset, or its generation has not finished "
                f"(run 'gof generate' on it again to resume)"
            )
        meta = read_json(source)
        if not isinstance(meta, dict) or meta.get("schema") != SCHEMA or meta.get("version") != VERSION:
            raise DataFormatError(f"{source}: not schema '{SCHEMA}' version {VERSION}")
        missing = [key for key in _REQUIRED if key not in meta]
        if missing:
            raise DataFormatError(f"{source}: fields {missing} are missing")
        times = _seconds(meta["time_s"])
        if times is None or len(times) == 0:
            raise DataFormatError(f"{source}: time_s must be a non-empty, strictly increasing list of seconds")
        if not isinstance(meta["cameras"], list) or not all(isinstance(c, dict) for c in meta["cameras"]):
            raise DataFormatError(f"{source}: cameras must be a list of objects")
        if not isinstance(meta.get("velocity") or "", str):
            raise DataFormatError(f"{source}: velocity must be the name of a store")
        cameras = [Camera.from_dict(c, str(source)) for c in meta["cameras"] if c.get("role", "train") == "train"]
        if not cameras:
            raise DataFormatError(f"{source}: no camera with role 'train'")
        if len({c.name for c in cameras}) < len(cameras):
            raise DataFormatError(f"{source}: two cameras have the same name")
        for name in ("train", "test"):
            frames = meta["splits"].get(name) if isinstance(meta["splits"], dict) else None
            if not isinstance(frames, list) or any(type(k) is not int or not 0 <= k < len(times) for k in frames):
                raise DataFormatError(f"{source}: splits.{name} must list frame numbers below {len(times)}")
        for entry in meta["cameras"]:
            own = entry.get("time_s")
            if own is None:
                continue
            own = _seconds(own)
            if own is None or own.shape != times.shape:
                raise DataFormatError(
                    f"{source}: camera '{entry.get('name')}': time_s must hold {len(times)} strictly increasing seconds, "
                    "one per frame of the dataset"
                )
        return cls(folder, meta, cameras, times)

    @property
    def train_frames(self) -> list[int]:
        return self.meta["splits"]["train"]

    @property
    def test_frames(self) -> list[int]:
        """Held-out frames: neither their pictures nor flow from or to them may be used by a method."""
        return self.meta["splits"]["test"]

    @property
    def frame_time_s(self) -> float:
        """Median time between two frames; 0 for a single frame."""
        return float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0

    def camera_times_s(self, camera: int) -> np.ndarray:
        """(T,) float64 s: when this camera's frames start (its first line is read), on the dataset clock.

        Cameras that are not triggered together have a `time_s` of their own in dataset.json; without it, the common clock.
        """
        own = self._entry(camera).get("time_s")
        return self.times_s if own is None else np.asarray(own, np.float64)

    def file(self, camera: int, kind: str, frame: int = 0) -> Path:
        """Path of a camera's "rgb", "exr", "mask", "static" or "board_mask" file for a frame."""
        entry = self._entry(camera)
        if kind not in entry:
            raise DataFormatError(f"{self.path}/dataset.json: camera '{entry['name']}' has no '{kind}' files")
        return self._inside(FRAME.sub(lambda m: f"{frame:0{m[1] or 1}d}", str(entry[kind])))

    def image(self, camera: int, frame: int) -> np.ndarray:
        """(H, W, 3) float32 display sRGB in [0, 1]."""
        return self._read(self.file(camera, "rgb", frame), camera)

    def static(self, camera: int) -> np.ndarray:
        """(H, W, 3) float32 display sRGB in [0, 1]: the same view without fire."""
        return self._read(self.file(camera, "static"), camera)

    def mask(self, camera: int, frame: int) -> np.ndarray | None:
        """(H, W) float32 in [0, 1], 1 where flame is visible (ground truth); None when the dataset has no masks."""
        entry = self._entry(camera)
        if "mask" not in entry:
            return None
        return self._read(self.file(camera, "mask", frame), camera)[..., 0]

    def board_weight(self, camera: int) -> np.ndarray | None:
        """(H, W) float32 in [0, 1]: what a pixel counts for in scores, 0 on the sync board, soft at its edge (1 - mask).

        The board's LEDs are lit by the rig, not by the fire. None when the camera has no "board_mask": every pixel counts.
        """
        if "board_mask" not in self._entry(camera):
            return None
        return 1 - self._read(self.file(camera, "board_mask"), camera)[..., 0]

    @cached_property
    def velocity(self) -> VelocitySequence:
        """Ground-truth velocity over time.

        Raises:
            DataFormatError: the dataset has none (a real capture), or the store cannot be read.
        """
        if not self.meta.get("velocity"):
            raise DataFormatError(f"{self.path}: has no ground-truth velocity (a real capture?)")
        return VelocitySequence.open(self._inside(self.meta["velocity"]))

    def _inside(self, name: str) -> Path:
        """A path in the dataset, by its name in dataset.json, which may come from anybody."""
        try:
            path = (self.path / name).resolve()
            path.exists()  # asks the file system whether there can be such a name
        except (OSError, ValueError) as e:  # too long, a zero byte
            raise DataFormatError(f"{self.path}/dataset.json: {name[:80]!r} cannot be a file name") from e
        if not path.is_relative_to(self.path.resolve()):
            raise DataFormatError(f"{self.path}/dataset.json: '{name[:80]}' points outside the dataset")
        return path

    def _entry(self, camera: int) -> dict[str, Any]:
        return next(c for c in self.meta["cameras"] if str(c.get("name")) == self.cameras[camera].name)

    def _read(self, path: Path, camera: int) -> np.ndarray:
        import cv2

        if not path.is_file():
            raise DataFormatError(f"{path}: no such file")
        try:
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        except cv2.error:  # a header that announces more than 2^30 pixels
            image = None
        if image is None:
            raise DataFormatError(f"{path}: cannot be decoded; delete it and resume the generation")
        expected = self.cameras[camera].height, self.cameras[camera].width
        if image.shape[:2] != expected:
            raise DataFormatError(
                f"{path}: is {image.shape[1]}x{image.shape[0]}, the camera says {expected[1]}x{expected[0]}"
            )
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB).astype(np.float32) / 255


def _seconds(value: Any) -> np.ndarray | None:
    """A strictly increasing list of times as an array; None when it is none."""
    try:
        times = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return times if times.ndim == 1 and np.isfinite(times).all() and (np.diff(times) > 0).all() else None
