"""Small real videos, and what cameras and copying do to their files, written box by box as ISO/IEC 14496-12 lays out.

So what a reader must find is known from the bytes written, not from a second reader.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 96, 64
PARENTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
MATRIX = {  # tkhd's (a, b, c, d): a player maps (x, y) to (a x + c y, b x + d y); degrees clockwise, y is down
    0: (1, 0, 0, 1),
    90: (0, 1, -1, 0),
    180: (-1, 0, 0, -1),
    270: (0, -1, 1, 0),
}


def numbered(count: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Iterable[np.ndarray]:
    """Pictures (H, W, 3) uint8 whose grey is 8 x their number (up to 31), with a white corner above on the left."""
    for k in range(count):
        picture = np.full((size[1], size[0], 3), 8 * k, np.uint8)
        picture[: size[1] // 4, : size[0] // 4] = 255
        yield picture


def number_of(picture: np.ndarray) -> int:
    """Of a picture of `numbered`, from its middle."""
    height, width = picture.shape[:2]
    return round(float(picture[height // 2 - 4 : height // 2 + 4, width // 2 - 4 : width // 2 + 4].mean()) / 8)


def write_video(path: Path, pictures: Iterable[np.ndarray], fps: float = 30.0) -> Path:
    """MPEG-4 part 2 in .mp4, or Motion JPEG in .avi."""
    writer = None
    for picture in pictures:
        if writer is None:
            code = cv2.VideoWriter_fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
            writer = cv2.VideoWriter(str(path), code, fps, picture.shape[1::-1])
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
    writer.release()
    return path


# ---- boxes of an .mp4 ------------------------------------------------------------------------------------------------


def _boxes(data: bytes) -> list[tuple[bytes, bytes]]:
    """(kind, content) of the boxes in a row."""
    found, at = [], 0
    while at + 8 <= len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        assert size >= 8, "sizes of 0 and 1 are not written by OpenCV"
        found.append((kind, data[at + 8 : at + size]))
        at += size
    return found


def _joined(boxes: list[tuple[bytes, bytes]]) -> bytes:
    return b"".join(struct.pack(">I4s", 8 + len(content), kind) + content for kind, content in boxes)


def _changed(data: bytes, kind: bytes, change) -> bytes:
    """The boxes with `change(content)` instead of the content of every box of this kind, wherever it is."""
    return _joined(
        [
            (k, change(content) if k == kind else _changed(content, kind, change) if k in PARENTS else content)
            for k, content in _boxes(data)
        ]
    )


def tag_rotation(path: Path, degrees: int) -> Path:
    """Write the rotation tag: a player turns the pictures so many degrees clockwise."""
    return tag_matrix(path, *MATRIX[degrees])


def tag_matrix(path: Path, a: float, b: float, c: float, d: float) -> Path:
    """Write the matrix by which a player turns and mirrors the pictures."""

    def change(content: bytes) -> bytes:
        a_, b_, c_, d_ = (round(65536 * v) for v in (a, b, c, d))
        at = 40 if content[0] == 0 else 52  # version 1 has longer times
        return content[:at] + struct.pack(">9i", a_, b_, 0, c_, d_, 0, 0, 0, 1 << 30) + content[at + 36 :]

    path.write_bytes(_changed(path.read_bytes(), b"tkhd", change))
    return path


def tag_pixels(path: Path, width: int, height: int) -> Path:
    """Write the shape of a pixel (`pasp`) into the description of the film."""
    return _described(path, b"pasp", struct.pack(">II", width, height))


def tag_fields(path: Path) -> Path:
    """Write that a frame is two fields (`fiel`, of QuickTime's file format) into the description of the film."""
    return _described(path, b"fiel", b"\2\1")


def _described(path: Path, kind: bytes, box: bytes) -> Path:
    """Put a box into the description (of one film, which fills its `stsd`)."""

    def change(content: bytes) -> bytes:
        entry = content[12:] + _joined([(kind, box)])
        return content[:8] + struct.pack(">I", 4 + len(entry)) + entry

    path.write_bytes(_changed(path.read_bytes(), b"stsd", change))
    return path


def tag_focal(path: Path, kind: int, value: bytes, key: bytes = b"camera.focal_length.35mm_equivalent") -> Path:
    """Write a value into the film track's metadata, as Apple's phones do; its kind is a number of QuickTime's."""
    name = b"com.apple.quicktime." + key
    keys = (
        struct.pack(">II", 0, 2) + struct.pack(">I4s", 9, b"mdta") + b"a" + struct.pack(">I4s", 8 + len(name), b"mdta")
    )
    data = _joined([(b"data", struct.pack(">II", kind, 0) + value)])
    other = _joined([(b"data", struct.pack(">II", 1, 0) + b"else")])
    items = _joined([(struct.pack(">I", 1), other), (struct.pack(">I", 2), data)])
    handler = struct.pack(">II4s", 0, 0, b"mdta") + bytes(13)
    meta = _joined([(b"hdlr", handler), (b"keys", keys + name), (b"ilst", items)])
    path.write_bytes(_changed(path.read_bytes(), b"trak", lambda content: content + _joined([(b"meta", meta)])))
    return path


def tag_edits(path: Path, edits: list[tuple[float, float | None]]) -> Path:
    """Write an edit list, as trimming without coding anew does: (how long, from when on in the stored film), s; None:
    nothing is shown so long."""
    units = {}

    def read(kind: bytes, content: bytes) -> bytes:
        assert content[0] == 0, "OpenCV writes version 0"
        units[kind] = struct.unpack_from(">I", content, 12)[0]
        return content

    data = path.read_bytes()
    for kind in (b"mvhd", b"mdhd"):
        _changed(data, kind, lambda content, kind=kind: read(kind, content))
    rows = [
        struct.pack(
            ">IiI", round(lasts * units[b"mvhd"]), -1 if begins is None else round(begins * units[b"mdhd"]), 65536
        )
        for lasts, begins in edits
    ]
    edts = (b"edts", _joined([(b"elst", struct.pack(">II", 0, len(rows)) + b"".join(rows))]))

    def change(content: bytes) -> bytes:
        head, *others = [box for box in _boxes(content) if box[0] != b"edts"]
        return _joined([head, edts, *others])

    path.write_bytes(_changed(data, b"trak", change))
    return path


def set_date(path: Path, since_1904_s: int) -> Path:
    """When the file was made."""

    def change(content: bytes) -> bytes:
        return content[:4] + struct.pack(">I", since_1904_s) + content[8:]

    path.write_bytes(_changed(path.read_bytes(), b"mvhd", change))
    return path


def join_tracks(path: Path, first: Path, second: Path, shown: tuple[bool, bool]) -> Path:
    """A file with the films of two as its video tracks; players show those that are `shown`."""
    one, two = (dict(_boxes(p.read_bytes())) for p in (first, second))
    head = _joined([(b"ftyp", one[b"ftyp"])])
    where = {id(one): len(head) + 8, id(two): len(head) + 8 + len(one[b"mdat"])}
    traks = []
    for number, (source, boxes, usual) in enumerate(zip((first, second), (one, two), shown, strict=True), 1):
        data = source.read_bytes()
        shift = where[id(boxes)] - (data.index(b"mdat") + 4)

        def offsets(content: bytes, shift: int = shift) -> bytes:
            values = struct.unpack(f">{(len(content) - 8) // 4}I", content[8:])
            return content[:8] + struct.pack(f">{len(values)}I", *(value + shift for value in values))

        def header(content: bytes, number: int = number, usual: bool = usual) -> bytes:
            return (
                content[:3]
                + bytes([content[3] & 0xFE | usual])
                + content[4:12]
                + struct.pack(">I", number)
                + content[16:]
            )

        trak = _joined([(k, c) for k, c in _boxes(boxes[b"moov"]) if k == b"trak"])
        traks.append(_changed(_changed(trak, b"stco", offsets), b"tkhd", header))
    mvhd = _joined([(k, c) for k, c in _boxes(one[b"moov"]) if k == b"mvhd"])
    moov = mvhd + b"".join(traks)
    path.write_bytes(head + _joined([(b"mdat", one[b"mdat"] + two[b"mdat"]), (b"moov", moov)]))
    return path


def set_steps(path: Path, steps: list[float]) -> Path:
    """Give every frame its own duration, in multiples of what it was."""

    def change(content: bytes) -> bytes:
        old = struct.unpack(">I", content[12:16])[0]
        entries = b"".join(struct.pack(">II", 1, round(old * step)) for step in steps)
        return content[:4] + struct.pack(">I", len(steps)) + entries

    data = _changed(path.read_bytes(), b"stts", change)
    path.write_bytes(data.replace(b"edts", b"free"))  # else the old duration cuts the end
    return path


def cut_off(path: Path, share: float) -> Path:
    """Keep this share of the pictures' bytes, as a copy that broke off: what the file states goes first, as cameras
    that stream write it."""
    boxes = dict(_boxes(path.read_bytes()))
    shift = 8 + len(boxes[b"moov"])  # the pictures move back by so much
    before = 8 + len(boxes[b"ftyp"])

    def change(content: bytes) -> bytes:
        offsets = struct.unpack(f">{(len(content) - 8) // 4}I", content[8:])
        return content[:8] + struct.pack(f">{len(offsets)}I", *(offset + shift for offset in offsets))

    rest = [(kind, content) for kind, content in _boxes(path.read_bytes()) if kind not in (b"ftyp", b"moov")]
    whole = _joined([(b"ftyp", boxes[b"ftyp"])])
    whole += _changed(_joined([(b"moov", boxes[b"moov"])]), b"stco", change) + _joined(rest)
    pictures = len(whole) - before - shift
    path.write_bytes(whole[: before + shift + round(share * pictures)])
    return path
