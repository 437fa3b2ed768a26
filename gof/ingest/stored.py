"""What a dataset made from footage holds of each camera: its plate, pictures and masks, at the size they are stored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.cameras import Camera
from gof.core.files import path_in
from gof.dataset import CameraEntry
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import ROLL_DEG
from gof.footage.pictures import write_picture as save_picture
from gof.ingest.footage import Clip, Footage
from gof.ingest.frame_times import FrameTimes


@dataclass(frozen=True)
class StoredView:
    """A camera and its plate (H, W, 3) uint8 RGB at the size of the dataset's pictures."""

    camera: Camera
    plate: np.ndarray

    @property
    def rgb(self) -> str:
        """Pattern of its pictures' names."""
        return f"cameras/{self.camera.name}/rgb/{{frame:06d}}.png"

    @property
    def mask(self) -> str:
        """Pattern of its flame masks' names."""
        return f"cameras/{self.camera.name}/mask/{{frame:06d}}.png"

    @property
    def static(self) -> str:
        """Name of its plate."""
        return f"static/{self.camera.name}.png"

    @property
    def board_mask(self) -> str:
        """Name of the LED board's mask."""
        return f"cameras/{self.camera.name}/board_mask.png"


def stored_view(camera: Camera, plate: np.ndarray, max_size: int | None) -> StoredView:
    """The camera and its plate, shrunk to a longer side of `max_size` px; None keeps the size."""
    longest = max(camera.width, camera.height)
    size = min(max_size or longest, longest)
    small = camera.scaled(*(max(1, round(side * size / longest)) for side in (camera.width, camera.height)))
    return StoredView(small, resized(plate, small))


def resized(picture: np.ndarray, camera: Camera) -> np.ndarray:
    """The picture at the camera's size; every new pixel is the mean of the old ones it covers."""
    import cv2

    size = (camera.width, camera.height)
    return picture if picture.shape[1::-1] == size else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def write_pictures(out: Path, view: StoredView, clip: Clip) -> None:
    """A camera's plate, its clip, and where fire is in it: an estimate, as no truth exists."""
    write_picture(path_in(out, view.static), view.plate)
    plate = view.plate.astype(np.float32) / 255
    for k, frame in enumerate(clip):
        picture = resized(frame, view.camera)
        write_picture(path_in(out, view.rgb.format(frame=k)), picture)
        flame = flame_mask(picture.astype(np.float32) / 255, plate)
        write_picture(path_in(out, view.mask.format(frame=k)), flame[..., None].astype(np.uint8) * 255)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write an (H, W, 3) RGB or (H, W, 1) uint8 picture."""
    save_picture(path, picture[..., ::-1])


def camera_entries(
    footage: Footage, times: FrameTimes, stored: list[StoredView], boards: list[np.ndarray | None]
) -> tuple[CameraEntry, ...]:
    """What dataset.json says of the cameras."""
    return tuple(
        CameraEntry.of(
            view.camera,
            role="train",
            roll_deg=ROLL_DEG[footage.turn],
            rgb=view.rgb,
            mask=view.mask,
            static=view.static,
            board_mask=None if board is None else view.board_mask,
            time_s=tuple(time_s.tolist()),
        )
        for view, time_s, board in zip(stored, times.time_s, boards, strict=True)
    )
