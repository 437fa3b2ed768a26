"""The part of a video file's header that OpenCV does not tell: its video tracks, when they begin, their colours, and
whether frames are two fields."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gof.footage.colour import UNKNOWN, UNSAID, Colour

MOST_FRAMES, MOST_EDITS = 1 << 26, 1 << 12  # of one track: a week at 100 per second
MOST_READ = 1 << 20  # bytes at the beginning of an AVI or Matroska file in which its tracks are listed
FROM_1904_TO_1970 = 2_082_844_800  # s; MP4 counts from 1904
FOCAL_KEY = b"com.apple.quicktime.camera.focal_length.35mm_equivalent"
LONGEST_FOCAL_MM = 10_000.0
DAMAGED = (struct.error, IndexError, ValueError, OverflowError)  # a file that is wrong here is OpenCV's to refuse


@dataclass(frozen=True)
class VideoTrack:
    """One video track.

    Attributes:
        width, height: px, as the container states them.
        frames: how many players show; None: not stated.
        begins_s: when the first of them comes on the file's clock, exactly; None: not stated so.
        usual: whether players show it unless told otherwise.
        interlaced: whether the container says that a frame is two fields.
        colour: what its code values mean.
        mirrored: whether players show it mirrored.
    """

    width: int
    height: int
    frames: int | None = None
    usual: bool = True
    interlaced: bool = False
    colour: Colour = UNKNOWN
    mirrored: bool = False
    begins_s: float | None = None

    def __str__(self) -> str:
        return f"{self.width}x{self.height}" + (f" with {self.frames} frames" if self.frames else "")

    @property
    def is_picture(self) -> bool:
        """Whether it is a single picture: a cover or a thumbnail."""
        return self.frames == 1


def video_tracks(path: Path) -> list[VideoTrack]:
    """Return the video tracks of an MP4, MOV, Matroska, WebM or AVI file in their order; none for others and damaged
    ones."""
    try:
        with path.open("rb") as file:
            start = file.read(12)
            file.seek(0)
            if start[:4] == b"\x1aE\xdf\xa3":
                return list(_tracks_of_matroska(file.read(MOST_READ)))
            if start[:4] == b"RIFF" and start[8:] == b"AVI ":
                return list(_tracks_of_avi(file.read(MOST_READ)))
            return list(_tracks_of_mp4(read_header(file)))
    except DAMAGED:
        return []


def film_track(tracks: list[VideoTrack]) -> int | None:
    """Return the place of the film among video tracks; None where several may be it."""
    films = [k for k, track in enumerate(tracks) if not track.is_picture] or list(range(len(tracks)))
    if any(tracks[k].usual for k in films):
        films = [k for k in films if tracks[k].usual]
    largest = max((tracks[k].width * tracks[k].height for k in films), default=0)
    films = [k for k in films if tracks[k].width * tracks[k].height == largest]
    return films[0] if len(films) == 1 else None


def made_at(path: Path) -> int | None:
    """When an MP4 or MOV file says that it was made, s since 1970; None where it does not."""
    try:
        with path.open("rb") as file:
            header = read_header(file)
        found = inside(header, 0, len(header), b"mvhd")
        if found is None:
            return None
        since_1904 = struct.unpack_from(">Q" if header[found[0]] else ">I", header, found[0] + 4)[0]
    except DAMAGED:
        return None
    return since_1904 - FROM_1904_TO_1970 if since_1904 > FROM_1904_TO_1970 else None


def focal_35mm(path: Path) -> float | None:
    """Return the focal length for 35 mm film, mm, that an MP4 or MOV file states for its film; None where it does not.

    Apple's phones write it among the film track's metadata (QuickTime File Format, "Metadata"), as text or a number.
    """
    try:
        with path.open("rb") as file:
            header = read_header(file)
        places = [(0, len(header)), *boxes(header, 0, len(header), b"trak")]
        found = [value for place in places for value in _metadata(header, *place, FOCAL_KEY)]
        stated = [float(value) for value in found if 0 < value < LONGEST_FOCAL_MM]
    except DAMAGED:
        return None
    return stated[0] if len(set(stated)) == 1 else None


def _metadata(header: bytes, start: int, end: int, key: bytes) -> Iterator[float]:
    """Yield the numbers that a box `meta` gives to this key."""
    meta = inside(header, start, end, b"meta")
    if meta is None:
        return
    # MP4's box begins with a version, QuickTime's does not.
    meta = meta if header[meta[0] + 4 : meta[0] + 8] == b"hdlr" else (meta[0] + 4, meta[1])
    keys, items = inside(header, *meta, b"keys"), inside(header, *meta, b"ilst")
    if keys is None or items is None:
        return
    at = keys[0] + 8
    for number in range(1, struct.unpack_from(">I", header, keys[0] + 4)[0] + 1):
        size = struct.unpack_from(">I", header, at)[0]
        if size < 8 or at + size > keys[1]:
            return
        if header[at + 8 : at + size] == key:
            for item in boxes(header, *items, struct.pack(">I", number)):
                for place, last in boxes(header, *item, b"data"):
                    yield _number(struct.unpack_from(">I", header, place)[0], header[place + 8 : last])
        at += size


def _number(kind: int, value: bytes) -> float:
    """Return a value of QuickTime's metadata: text that begins with a number, a float, or a whole number."""
    if kind == 1:
        return float(value.decode().strip().removesuffix("mm"))
    if kind in (23, 24):
        return float(struct.unpack(">f" if kind == 23 else ">d", value)[0])
    return float(int.from_bytes(value, "big"))


# ---- containers ------------------------------------------------------------------------------------------------------


def _tracks_of_mp4(header: bytes) -> Iterator[VideoTrack]:
    for trak in boxes(header, 0, len(header), b"trak"):
        kind = inside(header, *trak, b"mdia", b"hdlr")
        shown = inside(header, *trak, b"tkhd")
        table = inside(header, *trak, b"mdia", b"minf", b"stbl")
        described = table and inside(header, *table, b"stsd")
        if not (kind and shown and table) or header[kind[0] + 8 : kind[0] + 12] != b"vide":
            continue
        if described is None:
            raise ValueError("a track of pictures without a description")
        entry = described[0] + 8  # the first one
        width, height = struct.unpack_from(">HH", header, entry + 32)
        more = entry + 86, entry + struct.unpack_from(">I", header, entry)[0]
        fields = inside(header, *more, b"fiel")
        units = _timescale(header, *trak, b"mdia", b"mdhd")
        frames, begins_s = _shown(_frame_times(header, *table), units, header, trak)
        yield VideoTrack(
            width,
            height,
            frames or None,
            bool(header[shown[0] + 3] & 1),
            fields is not None and header[fields[0]] == 2,
            _colour_of_mp4(header, *more),
            _is_mirrored(header, shown[0]),
            begins_s,
        )


def _timescale(header: bytes, start: int, end: int, *path: bytes) -> int:
    """Return the units per second of a box `mvhd` or `mdhd`. Raises ValueError: it is absent or 0."""
    at = (inside(header, start, end, *path) or (end, end))[0]
    if (units := struct.unpack_from(">I", header, at + (20 if header[at] == 1 else 12))[0]) == 0:
        raise ValueError("a clock without units")
    return units


def _frame_times(header: bytes, start: int, end: int) -> np.ndarray:
    """Return (N,) int64: when a track's frames are shown, in its units, before any edit; (0,) in a file of fragments.

    Raises:
        ValueError: it claims too many.
    """

    def repeated(kind: bytes) -> np.ndarray | None:
        if (box := inside(header, start, end, kind)) is None:
            return None
        count = struct.unpack_from(">I", header, box[0] + 4)[0]
        counts, values = np.frombuffer(header, ">i4", 2 * count, box[0] + 8).reshape(-1, 2).T.astype(np.int64)
        if not 0 <= counts.sum() <= MOST_FRAMES:
            raise ValueError(f"a track claims {counts.sum()} frames")
        return np.repeat(values, counts)

    if (steps := repeated(b"stts")) is None:
        return np.zeros(0, np.int64)
    decoded = np.cumsum(steps) - steps
    late = repeated(b"ctts")
    return decoded if late is None or len(late) != len(decoded) else decoded + late


def _shown(times: np.ndarray, units: int, header: bytes, trak: tuple[int, int]) -> tuple[int, float | None]:
    """Return how many of a track's frames players show by its edit list, and when the first of them comes, s.

    Args:
        times: (N,) of all frames, of `units` per second.
    Raises:
        ValueError: the list is too long to be one.
    """
    if not len(times):
        return 0, None
    box = inside(header, *trak, b"edts", b"elst")
    if box is None:
        return len(times), float(times.min() / units)
    count, form = struct.unpack_from(">I", header, box[0] + 4)[0], ">Qqi" if header[box[0]] == 1 else ">Iii"
    if count > MOST_EDITS:
        raise ValueError(f"an edit list claims {count} parts")
    per_second = _timescale(header, 0, len(header), b"mvhd")
    shown, begins_s, now_s = 0, None, 0.0
    for k in range(count):
        lasts, begins, _ = struct.unpack_from(form, header, box[0] + 8 + k * struct.calcsize(form))
        end = begins + lasts * units / per_second if lasts else np.inf
        part = times[(times >= begins) & (times < end)] if begins >= 0 else times[:0]
        shown += len(part)
        if len(part) and begins_s is None:
            begins_s = now_s + float(part.min() - begins) / units
        now_s += lasts / per_second
    return shown, begins_s


def _is_mirrored(header: bytes, at: int) -> bool:
    """Return whether the matrix of a box `tkhd` mirrors the pictures."""
    a, b, _, c, d = struct.unpack_from(">5i", header, at + (52 if header[at] == 1 else 40))
    return a * d - b * c < 0


def _colour_of_mp4(header: bytes, start: int, end: int) -> Colour:
    """Return that of a film's description: its box `colr` of code points."""
    for place, _ in boxes(header, start, end, b"colr"):
        if (kind := header[place : place + 4]) in (b"nclx", b"nclc"):  # the latter, of QuickTime, says no range
            primaries, transfer, matrix = struct.unpack_from(">HHH", header, place + 4)
            return Colour(primaries, transfer, matrix, kind == b"nclx" and header[place + 10] >> 7 == 1)
    return UNKNOWN


def _tracks_of_avi(data: bytes) -> Iterator[VideoTrack]:
    at = 0
    while (at := data.find(b"strh", at)) >= 0:
        if data[at + 8 : at + 12] == b"vids":
            frames = struct.unpack_from("<I", data, at + 40)[0]
            form = data.index(b"strf", at)
            width, height = struct.unpack_from("<ii", data, form + 12)
            yield VideoTrack(width, abs(height), frames or None)
        at += 4


def _tracks_of_matroska(data: bytes) -> Iterator[VideoTrack]:
    segment = next(_elements(data, 0, len(data), 0x18538067), None)
    tracks = segment and next(_elements(data, *segment, 0x1654AE6B), None)
    for entry in _elements(data, *tracks, 0xAE) if tracks else ():
        video = next(_elements(data, *entry, 0xE0), None)
        if video is None or _number_in(data, entry, 0x83, 0) != 1:
            continue
        yield VideoTrack(
            _number_in(data, video, 0xB0, 0),
            _number_in(data, video, 0xBA, 0),
            usual=_number_in(data, entry, 0x88, 1) == 1,
            interlaced=_number_in(data, video, 0x9A, 0) == 1,
            colour=_colour_of_matroska(data, video),
        )


def _colour_of_matroska(data: bytes, video: tuple[int, int]) -> Colour:
    place = next(_elements(data, *video, 0x55B0), None)
    if place is None:
        return UNKNOWN
    primaries, transfer, matrix = (_number_in(data, place, number, UNSAID) for number in (0x55BB, 0x55BA, 0x55B1))
    return Colour(primaries, transfer, matrix, _number_in(data, place, 0x55B9, 0) == 2)


def _elements(data: bytes, start: int, end: int, wanted: int) -> Iterator[tuple[int, int]]:
    """Yield first byte and end of each EBML element of this identity, between two places."""
    while start < end:
        identity, at = _variable(data, start, marked=True)
        size, at = _variable(data, at)
        last = end if size is None else min(at + size, end)
        if identity == wanted:
            yield at, last
        start = last


def _variable(data: bytes, at: int, marked: bool = False) -> tuple[int | None, int]:
    """Return an EBML number and the place behind it; None for a size that is not known."""
    length = 9 - data[at].bit_length()
    if length > 8 or at + length > len(data):
        raise ValueError("no EBML number")
    value = int.from_bytes(data[at : at + length], "big")
    if not marked:
        value -= 1 << (7 * length)
        if value == (1 << (7 * length)) - 1:
            return None, at + length
    return value, at + length


def _number_in(data: bytes, place: tuple[int, int], wanted: int, default: int) -> int:
    found = next(_elements(data, *place, wanted), None)
    return default if found is None else int.from_bytes(data[slice(*found)], "big")


# ----------------------------------------------------------------
# MP4 and MOV files: the boxes of their table of contents (ISO/IEC 14496-12).

MOST_HEADER = 1 << 28  # bytes of a file's table of contents; hours of footage have some 10 MB


def read_header(file: BinaryIO) -> bytes:
    """Return the content of the file's `moov` box; empty where there is none, as in a file that is no MP4.

    Raises:
        ValueError: it claims more than `MOST_HEADER` bytes.
    """
    while len(start := file.read(16)) >= 8:
        size, kind = struct.unpack(">I4s", start[:8])
        head = 8
        if size == 1 and len(start) == 16:
            size, head = struct.unpack(">Q", start[8:])[0], 16
        if kind == b"moov":
            if not head <= size <= MOST_HEADER:
                raise ValueError(f"its table of contents claims {size} bytes")
            file.seek(head - len(start), 1)
            return file.read(size - head)
        if size < head:
            return b""
        file.seek(size - len(start), 1)
    return b""


def boxes(data: bytes, start: int, end: int, wanted: bytes) -> Iterator[tuple[int, int]]:
    """Yield first byte and end of what each box of this type holds, between two places."""
    while start + 8 <= end:
        size, kind = struct.unpack_from(">I4s", data, start)
        if not 8 <= size <= end - start:
            return
        if kind == wanted:
            yield start + 8, start + size
        start += size


def inside(data: bytes, start: int, end: int, *path: bytes) -> tuple[int, int] | None:
    """Return first byte and end of what the first box at this path holds; None where there is none."""
    for kind in path:
        box = next(boxes(data, start, end, kind), None)
        if box is None:
            return None
        start, end = box
    return start, end
