"""What the cameras filmed, and through which lenses: pictures made upright and undistorted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gof.dataset import Splits, held_out
from gof.errors import DataFormatError, GofError
from gof.footage import count_frames, first_frame, stored_frames
from gof.ingest.frame_times import FrameTimes, Timing, read_frame_times
from gof.ingest.place import Placed, PoseOptions, place_cameras
from gof.lens import CalibratedCamera, Lens, Turn, prepare, read_cameras


@dataclass(frozen=True)
class Footage:
    """Videos or folders of pictures of one fire, one per fixed camera, and how to find out what they do not say.

    `gof.ingest.published` is footage that says more.

    Attributes:
        videos: in the cameras' order.
        lenses: of the pictures as stored.
        turn: how they are turned upright.
        world_to_camera: (C, 4, 4) of the upright pictures, metres, where the poses are known beforehand; else None.

    Raises:
        GofError: fewer than two videos.
    """

    videos: tuple[Path, ...]
    lenses: tuple[Lens, ...]
    turn: Turn = "none"
    world_to_camera: np.ndarray | None = None

    def __post_init__(self):
        if len(self.videos) < 2:
            raise GofError("give the footage of at least two cameras")

    @classmethod
    def open(cls, videos: list[Path], turn: Turn, cameras: Path | None, fov_deg: float | None) -> Footage:
        """With the intrinsics of a file of `gof.lens.read_cameras`, or one horizontal field of view for all.

        Poses are taken from the file if it has one of its own for every camera.

        Raises:
            GofError: both or neither are given; a video or the file cannot be read.
        """
        if (cameras is None) == (fov_deg is None):
            raise GofError("give the intrinsics with either --cameras FILE or --fov DEGREES")
        if cameras is None:
            sizes = [first_frame(video).shape[1::-1] for video in videos]
            return cls(tuple(videos), tuple(Lens.from_fov(*size, fov_deg) for size in sizes), turn)
        known = read_cameras(cameras, len(videos))
        return cls(tuple(videos), tuple(camera.lens for camera in known), turn, _poses(known))

    @property
    def names(self) -> list[str]:
        """What the dataset calls the cameras."""
        return [f"cam_{c}" for c in range(len(self.videos))]

    @property
    def upright_lenses(self) -> list[Lens]:
        """Of the prepared pictures."""
        return [lens.turned(self.turn) for lens in self.lenses]

    def frame_times(self, timing: Timing) -> FrameTimes:
        """Which frames are used, and when they were taken. Raises GofError as `read_frame_times`."""
        return read_frame_times(timing, self.counts()).turned(self.turn)

    def place(self, clips: list[np.ndarray], lowest: list[np.ndarray], options: PoseOptions) -> Placed:
        """The cameras' poses, from the prepared pictures; see `place_cameras`."""
        return place_cameras(clips, lowest, self.upright_lenses, self.names, self.world_to_camera, options)

    def splits(self, count: int) -> Splits:
        """Which of `count` frames are held out."""
        return held_out(count)

    def board_mask(self, camera: int) -> np.ndarray | None:
        """(H, W) uint8, 255 on the LED board, of the prepared picture; None where nothing says so beforehand."""
        return None

    def write_beside(self, out: Path) -> None:
        """Write into the dataset what only this kind of footage has: nothing."""

    @property
    def provenance(self) -> dict[str, Any]:
        """What else the dataset says of where it is from."""
        return {}

    def counts(self) -> list[int]:
        """How many frames each video has; reads them all, as containers lie."""
        return [count_frames(video) for video in self.videos]

    def prepared(self, camera: int, picture: np.ndarray) -> np.ndarray:
        """A camera's stored picture (H, W[, 3]) uint8, undistorted and upright."""
        return prepare(picture, self.lenses[camera], self.turn)

    def clips(self, frames: list[range]) -> list[np.ndarray]:
        """(T, H, W, 3) uint8 RGB per camera: the prepared pictures of these frame numbers."""
        return [
            read_clip(video, lens, self.turn, wanted)
            for video, lens, wanted in zip(self.videos, self.lenses, frames, strict=True)
        ]


def _poses(cameras: list[CalibratedCamera]) -> np.ndarray | None:
    """(C, 4, 4), or None unless every camera has a pose of its own."""
    poses = {camera.world_to_camera for camera in cameras if camera.world_to_camera is not None}
    return np.array([c.world_to_camera for c in cameras]) if len(poses) == len(cameras) else None


def read_clip(path: Path, lens: Lens, turn: Turn, frames: range) -> np.ndarray:
    """(T, H, W, 3) uint8 RGB: the prepared pictures of these frame numbers.

    Raises:
        DataFormatError: the footage is shorter, or of another size than the lens says.
    """
    clip = []
    for k, frame in enumerate(stored_frames(path)):
        if k >= frames.stop:
            break
        if frame.shape[:2] != (lens.height, lens.width):
            raise DataFormatError(
                f"{path}: frame {k} is {frame.shape[1]}x{frame.shape[0]}, "
                f"the lens is given for {lens.width}x{lens.height}"
            )
        if k in frames:
            clip.append(prepare(frame, lens, turn))
    if len(clip) < len(frames):
        raise DataFormatError(f"{path}: has {frames.start + len(clip)} frames, {frames.stop} are asked for")
    return np.stack(clip)
