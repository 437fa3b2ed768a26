"""One camera's recording, read as one video: its file, and the chapters in which it goes on, one after the other.

Every chapter's first frame comes one frame after the last of the chapter before: the camera films on while it changes
files. Each file has a clock of its own, on which its pictures and its sound lie; `OpenRecording.begins_s` joins them.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gof.core.errors import DataFormatError
from gof.footage.chapters import chapters_from
from gof.footage.containers import film_track, video_tracks

if TYPE_CHECKING:
    import cv2

ONE_RATE = 0.01  # relative: by which the stated rates of one recording's chapters may differ, short ones most


@contextmanager
def opened(path: Path) -> Iterator[OpenRecording]:
    """Provide a recording, from this file on.

    Raises:
        DataFormatError: no such file; OpenCV would read another track than the film; a chapter is missing, unreadable,
            or not of the same size, rate, codec or rotation.
    """
    recording = OpenRecording(chapters_from(path))
    try:
        yield recording
    finally:
        recording.close()


class OpenRecording:
    """A recording that is being read; pictures come as stored, whatever the rotation tag.

    Attributes:
        files: the chapters.
        stated_frames: by their containers, together; None: one does not state them.
        stamp_s: time of the last frame that was read, from the first one on.
        begins_s: time of each file's first frame from the recording's first one on, and on the file's own clock; of
            those that were begun.
    """

    def __init__(self, files: list[Path]):
        self.files = files
        self.stamp_s = 0.0
        self.begins_s: list[tuple[float, float]] = []
        self._chapter, self._stamps, self._zero_s = 0, list[float](), 0.0
        for file in files:
            if not file.is_file():
                raise DataFormatError(f"{file}: no such video or folder of pictures")
            _require_the_film_first(file)
        statements = [_Statements.of(file) for file in files] if len(files) > 1 else []
        if statements and not statements[0].width:
            raise unreadable(files[0])
        for file, stated in zip(files[1:], statements[1:], strict=True):
            stated.require_like(statements[0], file, files[0])
        self._video = _capture(files[0])
        counts = [s.frames for s in statements] or [_stated_frames(files[0], self._video)]
        self.stated_frames = None if None in counts else round(sum(count or 0 for count in counts))

    def close(self) -> None:
        """Close the file that is open."""
        self._video.release()

    def stated(self, name: str) -> float | None:
        """Return a property that the container of the open file states, by OpenCV's name for it; None: it does not."""
        return _stated(self._video, name)

    def grab(self) -> bool:
        """Go to the next frame, in the next file where one ends. Return whether there is one.

        Raises:
            DataFormatError: a file that is not the last breaks off.
        """
        import cv2

        while not self._video.grab():
            if self._chapter + 1 == len(self.files):
                return False
            self._go_on()
        own_s = self._video.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        if not self._stamps:
            rate = self.stated("FPS")
            # OpenCV tells it in whole frames only.
            start_s = begins_s(self.files[self._chapter])
            if start_s is None:
                start_s = max(self._video.get(cv2.CAP_PROP_PTS), 0.0) / rate if rate else 0.0
            if self._chapter > 0:
                self._zero_s -= own_s  # stamps may not begin at zero
            self.begins_s.append((self._zero_s + own_s, start_s))
        self.stamp_s = self._zero_s + own_s
        self._stamps.append(self.stamp_s)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        """Return whether the frame that was gone to can be decoded, and its picture (H, W, 3) uint8 BGR."""
        return self._video.retrieve()

    def frames(self) -> Iterator[np.ndarray]:
        """Yield the pictures that are left, up to one that cannot be decoded."""
        while self.grab():
            ok, picture = self.retrieve()
            if not ok:
                return
            yield picture

    def _go_on(self) -> None:
        """Open the next file. Its frames are on from one step after this one's last."""
        file, later = self.files[self._chapter : self._chapter + 2]
        tracks = video_tracks(file)
        stated = tracks[0].frames if tracks else None
        if not self._stamps:
            raise unreadable(file)
        if stated and len(self._stamps) < stated:
            raise DataFormatError(
                f"{file}: breaks off: {len(self._stamps)} of the {stated} frames that it states can be read, and the "
                f"recording goes on in {later.name}. Copy it from the camera again; to use what is there, keep "
                f"{later.name} elsewhere"
            )
        rate = self.stated("FPS")
        step_s = usual_step(np.array(self._stamps)) or (1 / rate if rate else 0.0)
        self._zero_s, self._stamps = self.stamp_s + step_s, []
        self._chapter += 1
        self._video.release()
        self._video = _capture(later)


def usual_step(stamps_s: np.ndarray) -> float | None:
    """Return the mean of the steps near the median of all, as stamps may be rounded; None where there is none."""
    steps = np.diff(stamps_s)
    middle = np.median(steps) if len(steps) else 0.0
    return float(steps[np.abs(steps - middle) <= 0.5 * middle].mean()) if middle > 0 else None


def unreadable(path: Path) -> DataFormatError:
    """Return the error for a file of which no frame can be read."""
    copy = shlex.quote(str(path.with_name(f"{path.stem}_again.mp4")))
    return DataFormatError(
        f"{path}: OpenCV reads no frame from it. Was it copied to its end? If a player shows it, re-encode it: ffmpeg "
        f"-noautorotate -i {shlex.quote(str(path))} -fps_mode passthrough -c:v libx264 -crf 12 {copy}"
    )


# ---- one file --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Statements:
    """Facts that a chapter's container states, alike in all chapters of one recording but for the frames."""

    width: float | None
    height: float | None
    rate: float | None
    codec: str
    rotation_deg: float
    frames: float | None

    @classmethod
    def of(cls, path: Path) -> _Statements:
        video = _capture(path)
        try:
            size = _stated(video, "FRAME_WIDTH"), _stated(video, "FRAME_HEIGHT")
            codec = int(_stated(video, "FOURCC") or 0).to_bytes(4, "little").decode("latin-1").strip("\0 ")
            turned = _stated(video, "ORIENTATION_META") or 0.0
            return cls(*size, _stated(video, "FPS"), codec, turned, _stated_frames(path, video))
        finally:
            video.release()

    def __str__(self) -> str:
        turned = f", turned by {self.rotation_deg:g} degrees" if self.rotation_deg else ""
        return f"{self.width or 0:g}x{self.height or 0:g}, {self.rate or 0:.5g} frames per second, {self.codec}{turned}"

    def require_like(self, first: _Statements, path: Path, first_path: Path) -> None:
        """Raise DataFormatError: a chapter cannot be of the recording that another one begins."""
        aside = f"keep it elsewhere to use what comes before it in {first_path.name}"
        if not self.width:
            raise DataFormatError(
                f"{path}: goes on with {first_path.name} by its name, and cannot be read; copy it from the camera "
                f"again, or {aside}"
            )
        shape = (self.width, self.height, self.codec, self.rotation_deg)
        alike = shape == (first.width, first.height, first.codec, first.rotation_deg)
        rates = sorted([self.rate or 0.0, first.rate or 0.0])
        if not alike or rates[1] > (1 + ONE_RATE) * rates[0]:
            raise DataFormatError(
                f"{path}: goes on with {first_path.name} by its name, but is {self}, and that is {first}. If it is of "
                f"another recording, {aside}"
            )


def _capture(path: Path) -> cv2.VideoCapture:
    """Return a file's video, which gives pictures as stored: OpenCV's versions differ in that."""
    import cv2

    video = cv2.VideoCapture(str(path))
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def _stated(video: cv2.VideoCapture, name: str) -> float | None:
    import cv2

    value = video.get(getattr(cv2, f"CAP_PROP_{name}"))
    return value if np.isfinite(value) and value > 0 else None


def _stated_frames(path: Path, video: cv2.VideoCapture) -> float | None:
    """Return how many frames a file states. OpenCV counts those, too, that its edit list (of a film that was trimmed)
    leaves out, and does not read them."""
    shown = [track.frames for track in video_tracks(path)[:1] if track.begins_s is not None]
    return shown[0] if shown else _stated(video, "FRAME_COUNT")


def begins_s(path: Path) -> float | None:
    """Return when the first frame of a file comes on the file's clock, s; None where its container does not state
    it."""
    tracks = video_tracks(path)
    return tracks[0].begins_s if tracks else None


def _require_the_film_first(path: Path) -> None:
    """Raise DataFormatError: OpenCV would read another track than the film."""
    tracks = video_tracks(path)
    film = film_track(tracks)
    if len(tracks) > 1 and film != 0:
        each = "; ".join(f"{k + 1}: {track}" for k, track in enumerate(tracks))
        which = "" if film else ", or another number"
        copy = shlex.quote(str(path.with_name(f"{path.stem}_film{path.suffix}")))
        raise DataFormatError(
            f"{path}: has {len(tracks)} video tracks ({each}), and the first one, which is read, need not be the "
            f"film. Take the film out: ffmpeg -i {shlex.quote(str(path))} -map 0:v:{film or 0} -c copy {copy}{which}"
        )
