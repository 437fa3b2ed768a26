"""What the cameras filmed, and through which lenses: pictures made upright and undistorted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError, GofError
from gof.footage import count_frames, first_frame, stored_frames
from gof.lens import CalibratedCamera, Lens, Turn, prepare, read_cameras


@dataclass(frozen=True)
class Footage:
    """Videos or folders of pictures of one fire, one per fixed camera.

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

    def counts(self) -> list[int]:
        """How many frames each video has; reads them all, as containers lie."""
        return [count_frames(video) for video in self.videos]

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
