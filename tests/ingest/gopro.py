"""Files as GoPro cameras write them, by the published layout of GPMF; no camera of theirs made them."""

import struct
from pathlib import Path

import numpy as np


def track(up: np.ndarray, order: str, gravity: np.ndarray | None = None, shake: float = 0.0) -> bytes:
    """A GPMF sample as a GoPro writes it whose top shows along `up` in Blender's camera axes (x right, y up, z back).

    GoPro's axes: X left, Y back, Z top; the accelerometer shows 9.81 to the top.

    Args:
        gravity: (3,) also written as GRAV, which points down in the picture's axes (x right, y down, z forward).
        shake: m/s2, the accelerometer goes to and fro by so much.
    """
    body = {"X": -up[0], "Y": up[2], "Z": up[1]}
    stored = [9.81 * body[axis.upper()] * (1 if axis.isupper() else -1) for axis in order]
    felt = np.array([stored] * 50) + shake * np.array([[1.0], [-1.0]] * 25)
    values = np.round(felt * 417).astype(">i2").tobytes()

    def entry(name, kind, size, data):
        return struct.pack(">4scBH", name, kind, size, len(data) // max(size, 1)) + data + b"\0" * (-len(data) % 4)

    def stream(*entries):
        nested = b"".join(entries)
        return struct.pack(">4scBH", b"STRM", b"\0", 1, len(nested)) + nested

    scale = entry(b"SCAL", b"s", 2, struct.pack(">h", 417))
    streams = stream(scale, entry(b"ORIN", b"c", 1, order.encode()), entry(b"ACCL", b"s", 6, values))
    if gravity is not None:
        pointing = np.round(np.array([gravity] * 30) * 32767).astype(">i2").tobytes()
        scale = entry(b"SCAL", b"s", 2, struct.pack(">h", 32767))
        streams += stream(scale, entry(b"GRAV", b"s", 6, pointing))
    return struct.pack(">4scBH", b"DEVC", b"\0", 1, len(streams)) + streams


def box(kind: bytes, *parts: bytes) -> bytes:
    return struct.pack(">I4s", 8 + sum(map(len, parts)), kind) + b"".join(parts)


def with_track(video: Path, sample: bytes) -> None:
    """Add a GPMF track of one sample to an MP4 file whose `moov` stands at its end, as OpenCV writes it."""
    data = video.read_bytes()
    at = data.rindex(b"moov") - 4
    old = data[at + 8 :]

    def trak(offset):
        tables = (
            box(b"stsd", struct.pack(">II", 0, 1), box(b"gpmd", bytes(6), struct.pack(">HI", 1, 0))),
            box(b"stts", struct.pack(">IIII", 0, 1, 1, 1000)),
            box(b"stsc", struct.pack(">IIIII", 0, 1, 1, 1, 1)),
            box(b"stsz", struct.pack(">III", 0, len(sample), 1)),
            box(b"stco", struct.pack(">III", 0, 1, offset)),
        )
        head = box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 1000, 1000, 0, 0))
        kind = box(b"hdlr", bytes(8), b"meta", bytes(12), b"GoPro MET\0")
        known = box(b"tkhd", struct.pack(">IIIII", 0, 0, 0, 9, 0), bytes(64))
        return box(b"trak", known, box(b"mdia", head, kind, box(b"minf", box(b"stbl", *tables))))

    offset = at + 8 + len(old) + len(trak(0)) + 8
    video.write_bytes(data[:at] + box(b"moov", old, trak(offset)) + box(b"mdat", sample))


def film(path: Path, sample: bytes) -> Path:
    """An MP4 file with nothing but such a track."""
    path.write_bytes(box(b"ftyp", b"isom", bytes(4)) + box(b"moov"))
    with_track(path, sample)
    return path
