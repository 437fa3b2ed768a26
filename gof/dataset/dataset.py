"""Opening a dataset folder: its cameras, times and pictures, and the true velocity."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gof.core.cameras import Camera
from gof.core.datum import Datum
from gof.core.description import FILE, PICTURES, CameraEntry, DatasetDescription, dataset_folder
from gof.core.errors import DataFormatError
from gof.core.fields import VelocitySequence
from gof.core.files import path_in, stamp
from gof.core.flow import read_flow
from gof.core.records import to_json
from gof.dataset.poses import Poses
from gof.footage.pictures import read_picture

SEEN = ("rgb", "static", "mask", "board_mask")  # kinds of files that are made something from
ROLES = ("train", "eval", "around")  # of cameras


@dataclass(frozen=True)
class Dataset:
    """A capture or a benchmark scene. Frames and cameras are numbered from 0; images are read when needed.

    A world or a clock far from zero (UTM coordinates, Unix time) is measured from `datum`: cameras, times and the true
    velocity alike. `description` says what the file says.

    Attributes:
        path: the folder.
        description: what dataset.json says.
        cameras: the reconstruction's cameras (role "train"), in file order.
        times_s: (T,) float64 frame times on the dataset clock.
    """

    path: Path
    description: DatasetDescription
    cameras: list[Camera]
    times_s: np.ndarray

    @classmethod
    def open(cls, folder: str | Path) -> Dataset:
        """Read `folder/dataset.json`; that file may be named instead of its folder.

        Raises:
            DataFormatError: no dataset there, another schema or version, a missing or malformed field.
        """
        folder = dataset_folder(Path(folder))
        description = DatasetDescription.read(folder)
        datum = description.datum
        times_s = np.asarray(description.time_s, np.float64) - datum.time_s
        return cls(folder, description, description.cameras_from(datum, "train"), times_s)

    def evaluation_view(self) -> Dataset | None:
        """Return the same dataset seen by its cameras of role "eval", for novel views; None when it has none."""
        return self._seen_by("eval")

    def around_view(self) -> Dataset | None:
        """Return the same dataset seen by its cameras of role "around", which have `frames` of it; None when it has
        none."""
        return self._seen_by("around")

    def _seen_by(self, role: str) -> Dataset | None:
        cameras = self.description.cameras_from(self.datum, role)
        return replace(self, cameras=cameras) if cameras else None

    def frames(self, camera: int) -> list[int]:
        """Return numbers of the frames that a camera has pictures of."""
        known = self._entry(camera).frames
        return list(range(len(self.times_s)) if known is None else known)

    @cached_property
    def datum(self) -> Datum:
        """Return the datum of places and times; zeros unless float32 would round the values."""
        return self.description.datum

    def sparse_points(self) -> np.ndarray:
        """Return (N, 3) points of what stands still, found with the poses, measured from the datum as the cameras are;
        none where the poses are not from footage."""
        poses = Poses.read(self.path)
        return np.zeros((0, 3)) if poses is None else poses.points_array() - self.datum.position

    @property
    def train_frames(self) -> list[int]:
        return list(self.description.splits.train)

    @property
    def test_frames(self) -> list[int]:
        """Held-out frames: neither their pictures nor flow from or to them may be used by a method."""
        return list(self.description.splits.test)

    @property
    def frame_time_s(self) -> float:
        """Median time between two frames; 0 for a single frame."""
        return float(np.median(np.diff(self.times_s))) if len(self.times_s) > 1 else 0.0

    def camera_times_s(self, camera: int) -> np.ndarray:
        """Return (T,) float64 s: when this camera's frames start (its first line is read), on the dataset clock.

        Cameras that are not triggered together have a `time_s` of their own in dataset.json; the others keep the common
        clock.
        """
        own = self._entry(camera).time_s
        return self.times_s if own is None else np.asarray(own, np.float64) - self.datum.time_s

    def name(self, camera: int, kind: str, frame: int = 0) -> str:
        """Name of a camera's file for a frame, relative to the dataset.

        Args:
            kind: "rgb", "exr", "mask", "static", "flow" or "board_mask".
        Raises:
            DataFormatError: the camera has no such files.
        """
        entry = self._entry(camera)
        name = entry.file_name(kind, frame)
        if name is None:
            raise DataFormatError(f"{self.path}/{FILE}: camera '{entry.name}' has no '{kind}' files")
        return name

    def file(self, camera: int, kind: str, frame: int = 0) -> Path:
        """Return path of a file; see `name`. Raises DataFormatError: no such kind, or a path that leaves the
        dataset."""
        return path_in(self.path, self.name(camera, kind, frame))

    def identity(self, *others: str) -> str:
        """Return the dataset's name, and digits that change with its description and its pictures' sizes and times of
        change.

        Files made from a dataset keep this digest: two datasets in folders of equal names differ, a moved one does
        not. Views from all around are only scored, so adding some does not change it.

        Args:
            others: names of more files in it that matter.
        """
        frames, seen = range(len(self.times_s)), self._given()
        names = {entry.file_name(kind, frame) for entry in seen.cameras for kind in SEEN for frame in frames}
        return self._digest(stamp(self.path, {*filter(None, names), *others}))

    def scored_as(self) -> str:
        """Return the dataset's name, and digits that change with its description alone: scores keep them, so that
        those of other footage, frames or splits are told apart on any machine. A copy has the same."""
        return self._digest("")

    def _given(self) -> DatasetDescription:
        """Return the description without views that are only scored."""
        return replace(self.description, cameras=tuple(c for c in self.description.cameras if c.role != "around"))

    def _digest(self, files: str) -> str:
        about = to_json(self._given())
        for entry in about["cameras"]:
            if entry["frames"] is None:  # as it was before there was such a field
                del entry["frames"]
        text = json.dumps(about, sort_keys=True)
        return f"{self.description.name} {hashlib.sha256((text + files).encode()).hexdigest()[:16]}"

    def require_files(
        self, kinds: Collection[str] = PICTURES, roles: Collection[str] = ROLES, frames: Collection[int] | None = None
    ) -> None:
        """Look whether the files are there that dataset.json names; none is opened.

        Args:
            kinds: of files, as in `name`.   roles: of cameras.   frames: their numbers; None = all.
        Raises:
            DataFormatError: one is absent; names the first.
        """
        absent = []
        for entry in (entry for entry in self.description.cameras if entry.role in roles):
            own = range(len(self.times_s)) if entry.frames is None else entry.frames
            seen = own if frames is None else sorted(set(frames).intersection(own))
            names = dict.fromkeys(entry.file_name(kind, frame) for kind in kinds for frame in seen)
            absent += [name for name in names if name is not None and not path_in(self.path, name).is_file()]
        if absent:
            others = f", and {len(absent) - 1} more files" if len(absent) > 1 else ""
            raise DataFormatError(
                f"{self.path / absent[0]}: no such file{others}, which dataset.json names; copy, unpack or make the "
                "dataset again"
            )

    def image(self, camera: int, frame: int) -> np.ndarray:
        """Return (H, W, 3) float32 display sRGB in [0, 1]."""
        return self._read(self.file(camera, "rgb", frame), camera)

    def static(self, camera: int) -> np.ndarray:
        """Return (H, W, 3) float32 display sRGB in [0, 1]: the same view without fire."""
        return self._read(self.file(camera, "static"), camera)

    def mask(self, camera: int, frame: int) -> np.ndarray | None:
        """Return (H, W) float32 in [0, 1], 1 where flame is visible (ground truth); None when the dataset has no
        masks."""
        if self._entry(camera).mask is None:
            return None
        return self._read(self.file(camera, "mask", frame), camera)[..., 0]

    def board_weight(self, camera: int) -> np.ndarray | None:
        """Return (H, W) float32 in [0, 1]: what a pixel counts for in scores: 0 on the board, soft at its edge (1 -
        mask).

        The board's LEDs are lit by the rig, not by the fire. None when the camera has no "board_mask": all count.
        """
        if self._entry(camera).board_mask is None:
            return None
        return 1 - self._read(self.file(camera, "board_mask"), camera)[..., 0]

    def has_flow(self, camera: int) -> bool:
        """Return whether the exact motion of a camera's pixels is known (never of a real capture)."""
        return self._entry(camera).flow is not None

    def true_flow(self, camera: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the exact motion of the flame's pixels, (H, W, 2) px per frame right and down, and their light (H, W).

        Light 0 is where no flame is, and its motion 0. It is that of the frame's nominal time, `times_s`, whatever the
        shutter.

        Raises:
            DataFormatError: the dataset does not have it (a real capture, or no `ground_truth: flow` in its spec), or
                the file is absent, damaged, or of another size than the camera.
        """
        path = self.file(camera, "flow", frame)
        flow, light = read_flow(path)
        size = (self.cameras[camera].height, self.cameras[camera].width)
        if light.shape != size:
            raise DataFormatError(f"{path}: has {light.shape} pixels (height, width), its camera has {size}")
        return flow, light

    @property
    def has_velocity(self) -> bool:
        """Return whether the true velocity is known (never of a real capture)."""
        return self.description.velocity is not None

    @cached_property
    def velocity(self) -> VelocitySequence:
        """Ground-truth velocity over time.

        Raises:
            DataFormatError: the dataset has none (a real capture), or the store cannot be read.
        """
        if self.description.velocity is None:
            raise DataFormatError(f"{self.path}: has no ground-truth velocity (a real capture?)")
        return VelocitySequence.open(path_in(self.path, self.description.velocity)).measured_from(self.datum)

    def _entry(self, camera: int) -> CameraEntry:
        name = self.cameras[camera].name
        return next(entry for entry in self.description.cameras if entry.name == name)

    def _read(self, path: Path, camera: int) -> np.ndarray:
        image = read_picture(path, size=(self.cameras[camera].width, self.cameras[camera].height))
        return image[..., ::-1].astype(np.float32) / 255


def open_dataset(folder: str | Path) -> Dataset:
    """Open a dataset: `Dataset.open`, by the name that the front door gives it.

    Raises:
        DataFormatError: there is no dataset in the folder, or a field of its dataset.json is missing or malformed.
    """
    return Dataset.open(folder)
