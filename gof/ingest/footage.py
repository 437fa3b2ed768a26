"""Clips as the cameras filmed them, and their lenses: pictures made upright and undistorted, read as they are
needed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, GofError
from gof.core.files import path_in
from gof.dataset import CameraEntry, Splits, held_out
from gof.footage.containers import focal_35mm
from gof.footage.flame_mask import flame_mask
from gof.footage.lens import ROLL_DEG, CalibratedCamera, Lens, Turn, preparation, read_cameras
from gof.footage.pictures import write_picture as save_picture
from gof.footage.steadying import FrameCorrection
from gof.footage.videos import VideoInfo, chosen_frames, read_info, require_different
from gof.host.terminal import progress_bar
from gof.ingest.agreement import other_notes, require_square_pixels, turns_by_tags
from gof.ingest.focal import FEWEST_CAMERAS, ChosenLenses, LensSearch, require_findable, start_search
from gof.ingest.frame_times import FrameTimes, Timing, read_frame_times
from gof.ingest.place import Placed, place_cameras
from gof.ingest.pose_clues import CHOICES, PoseClues, PoseOptions


@dataclass(frozen=True)
class PreparedClip(Collection[np.ndarray]):
    """Frames of one camera, prepared; every pass over it reads the footage again, so that it takes no memory.

    Attributes:
        path: video or folder of pictures.
        size: width, height of the stored pictures, px.
        frames: stored frame numbers, increasing.
        prepared: what is done to every stored picture (H, W, 3) uint8 RGB.
        corrections: what is done to it afterwards, by the stored number: see `gof.footage.steadying`.
        watch: called after every frame.
    """

    path: Path
    size: tuple[int, int]
    frames: tuple[int, ...]
    prepared: Callable[[np.ndarray], np.ndarray]
    corrections: Mapping[int, FrameCorrection] = field(default_factory=dict)
    watch: Callable[[], None] = lambda: None

    def __len__(self) -> int:
        return len(self.frames)

    def __contains__(self, picture: object) -> bool:
        return any(picture is frame for frame in self)

    def __iter__(self) -> Iterator[np.ndarray]:
        """Yield (H, W, 3) uint8 RGB. Raises DataFormatError: the footage is shorter, or of another size than the
        lens."""
        for number, picture in zip(self.frames, chosen_frames(self.path, self.frames), strict=True):
            if picture.shape[1::-1] != self.size:
                raise DataFormatError(
                    f"{self.path}: frame {number} is {picture.shape[1]}x{picture.shape[0]}, "
                    f"the lens is given for {self.size[0]}x{self.size[1]}"
                )
            picture = self.prepared(picture)
            correction = self.corrections.get(number)
            yield picture if correction is None else correction.applied(picture)
            self.watch()

    def only(self, places: Iterable[int]) -> PreparedClip:
        """Return its frames at these places."""
        return replace(self, frames=tuple(self.frames[k] for k in places))


@dataclass(frozen=True)
class Footage:
    """Videos or folders of pictures of one fire, one per fixed camera, and how to find out what they do not say.

    `gof.ingest.published` is footage that says more.

    Attributes:
        videos: in the cameras' order.
        lenses: of the pictures as stored.
        turns: how each camera's are turned upright.
        world_to_camera: (C, 4, 4) of the upright pictures, metres, where the poses are known beforehand; else None.
        infos: what the videos' files say, read to their ends.
        notes: what a user should know of them, in words.
        lens: source of the lenses, in words.
        search: how their focal lengths are to be found; None where they are known.

    Raises:
        GofError: no video.
    """

    videos: tuple[Path, ...]
    lenses: tuple[Lens, ...]
    turns: tuple[Turn, ...]
    world_to_camera: np.ndarray | None = None
    infos: tuple[VideoInfo, ...] = ()
    notes: tuple[str, ...] = ()
    lens: str = ""
    search: LensSearch | None = None

    def __post_init__(self):
        if not self.videos:
            raise GofError("give the footage of at least one camera")

    @classmethod
    def open(
        cls,
        videos: list[Path],
        turn: Turn | Literal["auto"] | Sequence[Turn | Literal["auto"]],
        cameras: Path | None,
        fov_deg: float | None,
    ) -> Footage:
        """With the intrinsics of a file of `gof.footage.lens.read_cameras`, or one horizontal field of view for all;
        else with a start from which `gof.ingest.focal` finds them.

        Poses are taken from the file if it has one of its own for every camera.

        Args:
            turn: one for all or one each; "auto" turns as the file's rotation tag says.
        Raises:
            GofError: both intrinsics are given; none are, and the cameras are too few to find them; a video or the file
                cannot be read; by their rotation tags some pictures stand and some lie; the same footage is given
                twice.
        """
        if cameras is None and fov_deg is None:
            require_findable([focal_35mm(video) if video.is_file() else None for video in videos])
        if cameras is not None and fov_deg is not None:
            raise GofError("give the intrinsics with either --cameras FILE or --fov DEGREES")
        require_different(videos)
        known = [] if cameras is None else read_cameras(cameras, videos)
        infos = [_read(video) for video in videos]
        if not known:
            require_square_pixels(infos)
        notes = other_notes(infos, fov_deg is not None)
        turns = turns_by_tags(infos, turn)
        search: LensSearch | None = None
        if known:
            lenses, source = [camera.lens for camera in known], "--cameras"
        elif fov_deg is not None:
            lenses, source = [Lens.from_fov(info.width, info.height, fov_deg) for info in infos], "--fov"
        else:
            lenses, search = start_search([(info.width, info.height, info.focal_35mm) for info in infos])
            source = search.stated
            search = search if len(videos) >= FEWEST_CAMERAS else None
        poses = _poses(known) if known else None
        return cls(tuple(videos), tuple(lenses), turns, poses, tuple(infos), tuple(notes), source, search)

    def other(self, videos: list[Path]) -> Footage:
        """Another clip by the same cameras. Raises DataFormatError: a video cannot be read, or is stored otherwise."""
        infos = [_read(video) for video in videos]
        for info, mine in zip(infos, self.infos, strict=True):
            if (info.width, info.height) != (mine.width, mine.height):
                raise DataFormatError(f"{info.path}: has another size than {mine.path}; is it by the same camera?")
            if (info.rotation_deg, info.pixel_aspect) != (mine.rotation_deg, mine.pixel_aspect):
                raise DataFormatError(
                    f"{info.path}: is tagged as turned by {info.rotation_deg} degrees, with pixels "
                    f"{info.pixel_aspect:.4g} times as wide as high; {mine.path} by {mine.rotation_deg}, with "
                    f"{mine.pixel_aspect:.4g}; is it by the same camera?"
                )
        return replace(self, videos=tuple(videos), infos=tuple(infos))

    def all_clips(self) -> list[PreparedClip]:
        """Return every frame, whatever its time: enough for what stands still."""
        return self.clips([np.arange(count) for count in self.frame_counts])

    @property
    def frame_counts(self) -> list[int]:
        """How many frames each video has."""
        return [info.frames or 0 for info in self.infos]

    @property
    def names(self) -> list[str]:
        """Return the cameras' names in the dataset."""
        return [f"cam_{c}" for c in range(len(self.videos))]

    @property
    def upright_lenses(self) -> list[Lens]:
        """Return the lenses of the prepared pictures."""
        return [lens.turned(turn) for lens, turn in zip(self.lenses, self.turns, strict=True)]

    def frame_times(self, timing: Timing) -> FrameTimes:
        """Return which frames are used, and when they were taken. Raises GofError as `read_frame_times`."""
        return read_frame_times(timing, list(self.infos)).turned(self.turns)

    def require_fitting(self, options: PoseOptions) -> None:
        """Raise GofError: poses are known, and an option would choose others."""
        if self.world_to_camera is not None:
            options.require_no_choice("those of --cameras", (*CHOICES, "rig", "sketch"))
        elif options.rig is not None:
            options.require_no_choice("those of --rig", CHOICES)

    def place(self, clips: list[PoseClues], options: PoseOptions) -> Placed:
        """Return the cameras' poses, from this clip and others of the same rig; see `place_cameras`."""
        return place_cameras(clips, self.upright_lenses, self.names, self.world_to_camera, options, self.search)

    def seen_through(self, found: ChosenLenses | None) -> Footage:
        """Return the same footage with the lenses that were found for its upright pictures; None: with its own."""
        if found is None:
            return self
        lenses = tuple(
            lens.magnified(upright.K[0, 0] / own.K[0, 0])
            for lens, own, upright in zip(self.lenses, self.upright_lenses, found.lenses, strict=True)
        )
        return replace(self, lenses=lenses, lens=found.words, search=None, notes=(*self.notes, *found.notes))

    def splits(self, count: int) -> Splits:
        """Return which of `count` frames are held out."""
        return held_out(count)

    def board_mask(self, camera: int, stored: np.ndarray | None) -> np.ndarray | None:
        """Return (H, W) uint8, 255 on the LED board, of the prepared picture, from that of the stored one, if there is
        one."""
        return None if stored is None else self.preparation(camera)(stored)

    def write_beside(self, out: Path) -> None:
        """Write into the dataset what only this kind of footage has: nothing."""

    @property
    def provenance(self) -> dict[str, Any]:
        """Return the dataset's further notes on its origin."""
        fov_deg = [round(lens.fov_deg, 3) for lens in self.lenses]
        lens = {"lens": self.lens, **({} if self.lens == "--cameras" else {"fov_deg": fov_deg})}
        return {"videos": [_described(info) for info in self.infos], "turn": list(self.turns), **lens}

    def preparation(self, camera: int) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function that makes a camera's stored pictures (H, W[, 3]) uint8 undistorted and upright."""
        return preparation(self.lenses[camera], self.turns[camera])

    def clips(self, frames: list[np.ndarray]) -> list[PreparedClip]:
        """Return the prepared pictures of these frame numbers, per camera."""
        return [
            PreparedClip(video, (lens.width, lens.height), tuple(map(int, wanted)), self.preparation(c))
            for c, (video, lens, wanted) in enumerate(zip(self.videos, self.lenses, frames, strict=True))
        ]


def _read(video: Path) -> VideoInfo:
    """Return the statements of its file, read to its end under a progress bar."""
    with progress_bar(f"read {video.name}") as update:
        return read_info(video, update)


UNSTATED = ("path", "stamps_s", "numbers", "begins_s")  # fields of VideoInfo that a dataset does not repeat


def _described(info: VideoInfo) -> dict[str, Any]:
    """For dataset.json."""
    stated = {f.name: getattr(info, f.name) for f in fields(info) if f.name not in UNSTATED}
    return {"name": info.path.name, **stated}


def _poses(cameras: list[CalibratedCamera]) -> np.ndarray | None:
    """Return (C, 4, 4); None where no camera has a pose. Raises DataFormatError: some have none of their own."""
    poses = {camera.world_to_camera for camera in cameras if camera.world_to_camera is not None}
    if poses and len(poses) < len(cameras):
        raise DataFormatError(
            f"--cameras: {len(poses)} poses (world_to_camera) for {len(cameras)} cameras; give each its own, or none"
        )
    return np.array([c.world_to_camera for c in cameras]) if poses else None


# ----------------------------------------------------------------
# Files of each camera in a dataset made from footage: its plate, pictures and masks, at the size they are stored.


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
    """Return the camera and its plate, shrunk to a longer side of `max_size` px; None keeps the size."""
    longest = max(camera.width, camera.height)
    size = min(max_size or longest, longest)
    small = camera.scaled(*(max(1, round(side * size / longest)) for side in (camera.width, camera.height)))
    return StoredView(small, resized(plate, small))


def resized(picture: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the picture at the camera's size; every new pixel is the mean of the old ones it covers."""
    import cv2

    size = (camera.width, camera.height)
    return picture if picture.shape[1::-1] == size else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def write_pictures(out: Path, view: StoredView, clip: PreparedClip) -> None:
    """Write a camera's plate, its clip, and where fire is in it: an estimate, as no truth exists."""
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
    """Return the cameras' entries in dataset.json."""
    return tuple(
        CameraEntry.of(
            view.camera,
            role="train",
            roll_deg=ROLL_DEG[turn],
            rgb=view.rgb,
            mask=view.mask,
            static=view.static,
            board_mask=None if board is None else view.board_mask,
            time_s=tuple(time_s.tolist()),
        )
        for view, turn, time_s, board in zip(stored, footage.turns, times.time_s, boards, strict=True)
    )
