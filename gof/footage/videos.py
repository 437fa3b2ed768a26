"""Pictures of one camera as stored, from a video or a folder, and what the file says of them.

OpenCV reads both. Its FFmpeg gives what a video's container states and every frame's time stamp; docs/ingest.md says
why no other library is used.
"""

from __future__ import annotations

import hashlib
import itertools
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.footage.chapters import chapters_before, chapters_from
from gof.footage.codecs import CodedStream
from gof.footage.colour import UNKNOWN, Colour
from gof.footage.containers import focal_35mm, made_at, video_tracks
from gof.footage.defects import FrameChanges, find_combs
from gof.footage.folders import PICTURES, UNREAD, loose_pictures, numbered_pictures, picture_files
from gof.footage.pictures import read_picture, read_rotation
from gof.footage.recording import opened, unreadable, usual_step

DEEP_FORMATS = (b"Y1", b"Y3", b"Y4", b"G3", b"G4")  # FFmpeg's tags of deep pixels; their fourth byte is the bits
ENDS = 1 << 20  # bytes at either end of a file that identify it
LOOKED_AT = 8  # pairs of frames that are looked at for combs
CUT_FRAMES, CUT_SHARE = 2, 0.01  # a file breaks off when more frames than both are missing at its end


@dataclass(frozen=True)
class VideoInfo:
    """A video's container in figures, and what reading it to its end found.

    Attributes:
        path: the video, or a folder of pictures.
        width, height: of the pictures as stored, px.
        stated_fps: frames per second by the container (slow motion often states the playback rate); None: none stated.
        stated_frames: by the container; some containers (Matroska) state a duration only, and this is an estimate.
        rotation_deg: 0, 90, 180 or 270: how far a player turns the pictures clockwise, by the container's tag.
        bits: per channel as stored; None where the format is not known. Pictures are read with 8.
        colour: "SDR", "HLG" or "PQ", as the file says; "": it does not. See `gof.footage.colour`.
        stamps_s: (N,) time stamps of the N frames that can be read, s; None for folders, or when not read to the end.
        frames: N; None when not read to the end.
        fingerprint: see `fingerprint`.
        numbers: of a folder's pictures, by their names, increasing; None for videos.
        pixel_aspect: width of a pixel over its height, as players show it.
        start_s: time of the first frame on the file's own clock; stamps_s count from it.
        two_fields: container or codec allow interlaced frames.
        repeated: numbers of the frames that show the one before again, see `gof.footage.defects`.
        chapters: names of the files in which the recording lies, `path` first; none where `path` is all of it.
        begins_s: time of the first frame of each chapter, on the clock of stamps_s and on its file's own; none of
            folders, or when not read to the end.
        made_s: when the file says that it was made, s since 1970; None: it does not.
        focal_35mm: focal length for 35 mm film that the file states, mm; None: it does not.
    """

    path: Path
    width: int
    height: int
    stated_fps: float | None = None
    stated_frames: int | None = None
    rotation_deg: int = 0
    bits: int | None = None
    stamps_s: np.ndarray | None = None
    frames: int | None = None
    fingerprint: str | None = None
    numbers: tuple[int, ...] | None = None
    pixel_aspect: float = 1.0
    start_s: float = 0.0
    made_s: int | None = None
    focal_35mm: float | None = None
    two_fields: bool = False
    colour: str = ""
    repeated: tuple[int, ...] = ()
    chapters: tuple[str, ...] = ()
    begins_s: tuple[tuple[float, float], ...] = ()

    @property
    def usual_step_s(self) -> float | None:
        """Usual time between neighbouring stamps: the mean of those near their median, as stamps may be rounded."""
        return None if self.stamps_s is None else usual_step(self.stamps_s)

    @property
    def duration_s(self) -> float | None:
        """Time from the first frame to the end of the last one; as stated where the frames are not read."""
        if self.stamps_s is not None and self.usual_step_s:
            return float(self.stamps_s[-1] - self.stamps_s[0]) + self.usual_step_s
        return self.stated_frames / self.stated_fps if self.stated_frames and self.stated_fps else None

    @property
    def breaks_off(self) -> bool:
        """Whether the file ends before the container says: neither its frames nor its duration are reached."""
        if self.frames is None or not self.stated_frames:
            return False
        least = self.stated_frames - max(CUT_FRAMES, CUT_SHARE * self.stated_frames)
        if self.frames >= least or self.stamps_s is None or self.usual_step_s is None or not self.stated_fps:
            return self.frames < least
        # At a variable rate the stated count can be an estimate; the last stamp tells.
        return (self.stamps_s[-1] - self.stamps_s[0] + self.usual_step_s) * self.stated_fps < least


# ---- reading ---------------------------------------------------------------------------------------------------------


def stored_frames(path: Path, in_time: bool = True) -> Iterator[np.ndarray]:
    """Yield frames as (H, W, 3) uint8 RGB display values, as stored, in file (video) or number (folder) order.

    Args:
        in_time: a folder's pictures are one sequence; False: any pictures, in any order.
    Raises:
        DataFormatError: not a readable video; a broken picture; see `picture_files`.
    """
    import cv2

    path = Path(path)
    if path.is_dir():
        for file in picture_files(path) if in_time else loose_pictures(path):
            yield cv2.cvtColor(read_picture(file), cv2.COLOR_BGR2RGB)
        return
    shown = colour_of(path).reader()
    with opened(path) as video:
        count = 0
        for count, frame in enumerate(video.frames(), 1):  # noqa: B007 (count is used behind the loop)
            yield shown(frame)
        if not count:
            raise unreadable(path)


def chosen_frames(path: Path, numbers: Iterable[int]) -> Iterator[np.ndarray]:
    """Yield the stored frames of these numbers, which increase, one at a time; as `stored_frames`.

    Raises:
        DataFormatError: as `stored_frames`; the footage ends before the last number.
    """
    import cv2

    path, numbers = Path(path), list(numbers)
    if path.is_dir():
        files = picture_files(path)
        _require_length(path, numbers, len(files))
        for number in numbers:
            yield cv2.cvtColor(read_picture(files[number]), cv2.COLOR_BGR2RGB)
        return
    shown = colour_of(path).reader()
    with opened(path) as video:
        at = 0
        for number in numbers:
            while at <= number and video.grab():
                at += 1
            _require_length(path, numbers, at, number)
            yield shown(video.retrieve()[1])


def colour_of(path: Path) -> Colour:
    """Return what the code values of a video's film, its first video track, mean: by its container, else by its
    stream."""
    if not path.is_file():
        return UNKNOWN
    stated = [track.colour for track in video_tracks(path)[:1] if replace(track.colour, full_range=False) != UNKNOWN]
    return stated[0] if stated else _coded_stream(path).colour


def _require_length(path: Path, numbers: list[int], read: int, number: int | None = None) -> None:
    """Raise DataFormatError: fewer frames were read than the one asked for (by default the last) needs."""
    if numbers and read <= (numbers[-1] if number is None else number):
        raise DataFormatError(f"{path}: has {read} frames, {numbers[-1] + 1} are wanted")


def _interlaced(path: Path, source: str) -> DataFormatError:
    if path.is_dir():
        return DataFormatError(
            f"{path}: is interlaced, {source}: every picture is two moments in turn, line by line. Take the pictures "
            "out of the video again, with ffmpeg's -vf bwdif"
        )
    copy = shlex.quote(str(path.with_name(f"{path.stem}_whole.mp4")))
    return DataFormatError(
        f"{path}: is interlaced, {source}: every frame is two moments in turn, line by line. Make whole frames of the "
        f"fields, twice as many: ffmpeg -i {shlex.quote(str(path))} -vf bwdif -c:v libx264 -crf 12 {copy}"
    )


# ---- which footage it is ---------------------------------------------------------------------------------------------


def fingerprint(path: Path) -> str:
    """Sixteen hex digits that tell footage from other footage, wherever it lies and whatever it is called.

    They come from a video's size, its first and its last MiB, or from the sizes of its chapters, and the first and last
    one; or from the sizes of a folder's pictures, and its first and last picture. Reading everything would take minutes
    for long films.

    Raises:
        DataFormatError: no such file, a pipe or a device, no picture in the folder; see `chapters_from`.
    """
    path = Path(path)
    files = picture_files(path) if path.is_dir() else chapters_from(path)
    for file in files:
        if not file.is_file():  # opening a pipe would wait for ever
            raise DataFormatError(f"{file}: no such {'picture' if path.is_dir() else 'video or folder of pictures'}")
    state = hashlib.sha256(" ".join(str(file.stat().st_size) for file in files).encode())
    for file in {files[0]: None, files[-1]: None}:
        with file.open("rb") as stream:
            state.update(stream.read(ENDS))
            stream.seek(max(file.stat().st_size - ENDS, 0))
            state.update(stream.read(ENDS))
    return state.hexdigest()[:16]


def require_different(paths: Iterable[Path]) -> None:
    """Raise DataFormatError: one of these is not there or is a single picture; or the same footage is given twice,
    perhaps as a copy or by two chapters of one recording."""
    known: dict[str, Path] = {}
    holders: dict[Path, Path] = {}
    for path in paths:
        if Path(path).suffix.lower() in {*PICTURES, *UNREAD} and not Path(path).is_dir():
            raise DataFormatError(f"{path}: is a single picture; give a video, or the folder of a camera's pictures")
        contents = fingerprint(path)
        files = chapters_from(Path(path))
        for file in files:
            if file.is_file() and not file.stat().st_size:
                raise DataFormatError(f"{file}: holds nothing; copy it from the camera again")
        if contents in known:
            other = known[contents]
            what = "is given twice" if path.samefile(other) else f"is the same footage as {other}"
            raise DataFormatError(f"{path}: {what}; give each camera's own")
        known[contents] = path
        for file in files:
            if (other := holders.setdefault(file.resolve(), path)) != path:
                first = min(path, other, key=lambda given: len(chapters_before(given)[1]))
                raise DataFormatError(
                    f"{path}: is of one recording with {other}, by their names: one camera wrote both. Give only "
                    f"{first.name} for this camera; what comes behind it is read with it"
                )


# ---- its own statements --------------------------------------------------------------------------------------------


def stated_info(path: Path) -> VideoInfo:
    """Return the container's statements, without reading more than one frame.

    Raises:
        DataFormatError: not a readable video, an empty folder, a broken picture, a film that is tagged as mirrored.
    """

    path = Path(path)
    height, width = next(iter(stored_frames(path))).shape[:2]
    if path.is_dir():
        numbers = tuple(number for number, _ in numbered_pictures(path))
        return VideoInfo(
            path,
            width,
            height,
            stated_frames=len(numbers),
            rotation_deg=_rotation(picture_files(path)),
            frames=len(numbers),
            fingerprint=fingerprint(path),
            numbers=numbers,
        )
    if any(track.mirrored for track in video_tracks(path)[:1]):
        raise DataFormatError(f"{path}: its matrix says mirrored; save the film as it should be seen, without the tag")
    with opened(path) as video:
        stated = video.stated
        bits, colour = _bits(stated("CODEC_PIXEL_FORMAT")), colour_of(path)
        if (bits or 8) > 8 and colour.full_range:
            raise _of_full_range(path, bits)
        return VideoInfo(
            path,
            width,
            height,
            stated("FPS"),
            video.stated_frames,
            round((stated("ORIENTATION_META") or 0) / 90) * 90 % 360,
            bits,
            fingerprint=fingerprint(path),
            pixel_aspect=(stated("SAR_NUM") or 1.0) / (stated("SAR_DEN") or 1.0),
            made_s=made_at(path),
            focal_35mm=focal_35mm(path),
            chapters=tuple(file.name for file in video.files if len(video.files) > 1),
            colour=colour.name,
            two_fields=any(track.interlaced for track in video_tracks(path)[:1]) or _coded_stream(path).two_fields,
        )


def _of_full_range(path: Path, bits: int | None) -> DataFormatError:
    """Return the error for a film that OpenCV would stretch: it knows full range with 8 bits only."""
    copy = shlex.quote(str(path.with_name(f"{path.stem}_tv.mp4")))
    return DataFormatError(
        f"{path}: has {bits} bits a channel in full range, of which OpenCV cuts off what is dark and what is bright; "
        f"code it anew: ffmpeg -noautorotate -i {shlex.quote(str(path))} -fps_mode passthrough -vf scale=out_range=tv "
        f"-c:v libx264 -crf 12 {copy}"
    )


def _rotation(files: list[Path]) -> int:
    """Return that of a folder's pictures, by their orientation tags. Raises DataFormatError: they differ; see
    `read_rotation`."""
    first = read_rotation(files[0])
    for file in files[1:]:
        if (other := read_rotation(file)) != first:
            raise DataFormatError(
                f"{file}: by its orientation tag it is turned by {other} degrees, {files[0].name} by {first}: did the "
                "camera move, or were some saved again without the tag? Make all alike"
            )
    return first


def _coded_stream(path: Path) -> CodedStream:
    """Return the statements of a video's stream; none where OpenCV does not tell."""
    import cv2

    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    try:
        codec = int(max(video.get(cv2.CAP_PROP_FOURCC), 0)).to_bytes(4, "little")
        ok, data = video.retrieve(None, int(video.get(cv2.CAP_PROP_CODEC_EXTRADATA_INDEX)))
        return CodedStream.of(codec, np.ravel(data).tobytes() if ok and data is not None else b"")
    except cv2.error:
        return CodedStream()
    finally:
        video.release()


def _bits(pixel_format: float | None) -> int | None:
    """Bits per channel by FFmpeg's tag of a pixel format."""
    if pixel_format is None:
        return None
    tag = int(pixel_format).to_bytes(4, "little")
    if tag[:2] in DEEP_FORMATS and 8 < tag[3] <= 16:
        return tag[3]
    return 10 if tag == b"P010" else 8


def read_info(path: Path, progress: Callable[[int, int], None] | None = None) -> VideoInfo:
    """Return the container's statements, and what reading all frames tells: their stamps (containers lie), repeats.

    Args:
        progress: called with frames read and stated.
    Raises:
        DataFormatError: as `stated_info`; it is interlaced.
    """

    info, changes = stated_info(path), FrameChanges()
    pairs = np.unique(np.linspace(0, max((info.stated_frames or LOOKED_AT) - 2, 0), LOOKED_AT).astype(int))
    wanted = {number + more for number in pairs.tolist() for more in (0, 1)}
    seen: dict[int, np.ndarray] = {}
    if info.path.is_dir():
        for number, picture in enumerate(stored_frames(info.path)):
            changes.add(picture)
            if number in wanted:
                seen[number] = picture
            if progress:
                progress(number + 1, info.frames or 0)
        info = replace(info, repeated=changes.repeated)
    else:
        stamps: list[float] = []
        with opened(info.path) as video:
            while video.grab():
                ok, picture = video.retrieve()
                if ok:
                    changes.add(picture)
                if ok and len(stamps) in wanted:
                    seen[len(stamps)] = picture
                stamps.append(video.stamp_s)
                if progress:
                    progress(len(stamps), max(len(stamps), info.stated_frames or 0))
        start = video.begins_s[0][1] if stamps else 0.0
        info = replace(info, stamps_s=np.array(stamps), frames=len(stamps), start_s=start, repeated=changes.repeated)
        info = replace(info, begins_s=tuple(video.begins_s))
        tracks = video_tracks(info.path)
        if info.stated_frames and not (tracks and tracks[0].frames):  # an estimate: the duration begins at zero
            info = replace(info, stated_frames=info.stated_frames - round(start * (info.stated_fps or 0.0)))
    alike = [(a, b) for a, b in itertools.pairwise(sorted(seen)) if b == a + 1 and seen[a].shape == seen[b].shape]
    combs = find_combs((seen[a], seen[b]) for a, b in alike)
    if combs.shown or (info.two_fields and not combs.ruled_out):
        raise _interlaced(info.path, "as its pictures show" if combs.shown else "its file says")
    return info


def chapters_in_words(info: VideoInfo) -> str | None:
    """Return which chapters of a recording are read, and which are not; None where there is only one."""
    number, before = chapters_before(info.path)
    words = []
    if info.chapters:
        duration = "" if info.duration_s is None else f", {info.duration_s:.0f} s"
        words.append(f"{len(info.chapters)} chapters, {_listed(info.chapters)}{duration}")
    if number > 1:
        left = f"{_listed(before)} before it {'are' if len(before) > 1 else 'is'}" if before else "what came before is"
        words.append(f"begins with chapter {number} of its recording; {left} not read")
    return f"{info.path.stem}: {'; '.join(words)}" if words else None


def chapter_lines(paths: Iterable[Path]) -> list[str]:
    """Return `chapters_in_words` of the footage that has several, by what its files state. Raises DataFormatError: they
    cannot be one recording."""
    several = [path for path in paths if len(chapters_from(path)) > 1 or chapters_before(path)[0] > 1]
    return [words for path in several if (words := chapters_in_words(stated_info(path)))]


def _listed(names: Sequence[str]) -> str:
    return " and ".join([*([", ".join(names[:-1])] if len(names) > 1 else []), names[-1]])


def stated_frames(path: Path) -> int | None:
    """Return the number of frames in a folder, or by a video's container (for progress bars), or None."""
    return len(loose_pictures(path)) if Path(path).is_dir() else stated_info(path).stated_frames


def stated_fps(path: Path) -> float | None:
    """Frame rate the container states (slow-motion files state the playback rate), None when it states none."""
    return stated_info(path).stated_fps


def distinct_names(paths: list[Path]) -> list[str]:
    """Return a name per footage: the stem, or parent and stem where stems repeat."""
    stems = [p.stem for p in paths]
    names = [s if stems.count(s) == 1 else f"{p.parent.name}_{s}" for s, p in zip(stems, paths, strict=True)]
    return [n if names.count(n) == 1 else f"{n}_{i}" for i, n in enumerate(names)]
