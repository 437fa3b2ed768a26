"""Which way is up, by the accelerometers of the cameras themselves: of a camera that stands still, they feel gravity.

Read are GoPro's: `GRAV`, where the camera has worked gravity out (MAX, HERO9 and later; HERO8 writes zeros), else
`ACCL`. A GoPro's own axes are X to the left, Y to the back and Z to the top, seen from behind it; at rest the
acceleration is 9.81 m/s2 to the top. `GRAV` points down, in the picture's axes.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gof.core.errors import DataFormatError
from gof.dataset.poses import UpReport
from gof.footage.containers import boxes, inside, read_header
from gof.footage.lens import CAMERA_AXES, Turn
from gof.ingest.up import angle_deg

BODY_TO_PICTURE = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])  # rows: right, down, forward
HERO5_ORDER = "ZXY"  # how a HERO5 stores them, and later ones that do not say
GRAVITY = 9.81
MOST_OFF = 0.15  # relative: HERO7 and earlier are not calibrated, one read 10.7 m/s2
MOST_SHAKE = 1.0  # m/s2, standard deviation along the vertical or across: hands and drones shake more, tripods less
MOST_ROLL_DEG = 45.0
MOST_APART_DEG = 5.0


@dataclass(frozen=True)
class Tilt:
    """The reading of a camera's accelerometer.

    Attributes:
        up: (3,) the vertical in the axes of the upright picture (x right, y down, z forward); None: it does not say.
        why: why not, in words; None where there is no accelerometer.
    """

    up: np.ndarray | None = None
    why: str | None = None


def read_tilt(video: Path, turn: Turn) -> Tilt:
    """Read that of a video whose stored pictures are turned upright so. A track that is not to be believed is named,
    not raised."""
    try:
        up = _stored_up(list(streams(video)))
    except DataFormatError as e:
        return Tilt(why=f"{video.name}: {e}")
    if up is None or isinstance(up, str):
        return Tilt(why=up and f"{video.name}: its accelerometer {up}")
    up = CAMERA_AXES[turn] @ up
    roll = abs(np.rad2deg(np.arctan2(up[0], -up[1])))
    if np.hypot(up[0], up[1]) > 0.5 and roll > MOST_ROLL_DEG:
        return Tilt(
            why=f"{video.name}: by its accelerometer the picture is {roll:.0f} degrees from upright; give --turn"
        )
    return Tilt(up)


def _stored_up(found: list[Stream]) -> np.ndarray | str | None:
    """Return (3,) unit vertical in the stored picture's axes, or why there is none."""
    gravity = [_scaled(s, "GRAV") for s in found if isinstance(s.get("GRAV"), np.ndarray)]
    if gravity and np.linalg.norm(down := np.concatenate(gravity).mean(0)) > 0.5:
        return -down / np.linalg.norm(down)
    felt = [s for s in found if isinstance(s.get("ACCL"), np.ndarray)]
    if not felt:
        return None
    order = felt[0].get("ORIN", HERO5_ORDER)
    if sorted(str(order).upper()) != ["X", "Y", "Z"]:
        return f"has axes '{order}', which are not known"
    acceleration = np.concatenate([_scaled(s, "ACCL") for s in felt])
    if len(acceleration) == 0:
        return "has no samples"
    body = np.zeros_like(acceleration)
    for column, axis in enumerate(order):
        body[:, "XYZ".index(axis.upper())] = acceleration[:, column] * (1 if axis.isupper() else -1)
    mean, shake = body.mean(0), body.std(0).max()
    size = float(np.linalg.norm(mean))
    if shake > MOST_SHAKE:
        return f"shakes by {shake:.1f} m/s2: the camera was moved"
    if abs(size / GRAVITY - 1) > MOST_OFF:
        return f"measures {size:.1f} m/s2 where gravity is {GRAVITY}"
    return BODY_TO_PICTURE @ mean / size


def _scaled(stream: Stream, name: str) -> np.ndarray:
    """Return (N, 3) in the sensor's unit. Raises DataFormatError: of another shape, not finite, or scaled by zero."""
    scale, values = stream.get("SCAL"), np.asarray(stream[name])
    divisor = scale.reshape(-1) if isinstance(scale, np.ndarray) else np.ones(1)
    if not np.isfinite(divisor).all() or (divisor == 0).any() or divisor.size not in (1, values.shape[1]):
        raise DataFormatError(f"its sensor '{name}' has the scale {divisor.tolist()}")
    if values.shape[1] != 3 or not np.isfinite(values).all():
        raise DataFormatError(f"its sensor '{name}' has samples that are not three finite numbers")
    return values / divisor


def up_from_tilts(poses: np.ndarray, tilts: tuple[Tilt, ...], near: np.ndarray) -> tuple[np.ndarray, UpReport] | str:
    """Return the vertical (3,) that the cameras' accelerometers agree on, or why there is none.

    Args:
        poses: (C, 4, 4) world to camera.   near: (3,) the cameras' mean up.
    """
    known = {c: poses[c, :3, :3].T @ tilt.up for c, tilt in enumerate(tilts) if tilt.up is not None}
    if not known:
        return "; ".join(tilt.why for tilt in tilts if tilt.why) or "no video has a track of a GoPro's accelerometer"
    mean = np.sum(list(known.values()), 0)
    if np.linalg.norm(mean) < 1e-6:
        return "the cameras' accelerometers contradict each other"
    mean /= np.linalg.norm(mean)
    apart = {c: angle_deg(up, mean) for c, up in known.items()}
    if max(apart.values()) > MOST_APART_DEG:
        each = ", ".join(f"cam_{c} {angle:.1f}" for c, angle in apart.items())
        return f"the cameras' accelerometers contradict each other (degrees from their mean: {each})"
    spread = None
    if len(known) > 1:
        spread = round(float(np.sqrt(np.sum(np.square(list(apart.values()))) / (len(known) - 1))), 2)
    return mean, UpReport("accelerometer", round(angle_deg(mean, near), 2), spread)


# ----------------------------------------------------------------
# GPMF: what GoPro cameras write beside the pictures, once a second, in a track of the MP4 file.
#
# Layout: the `gpmd` track's samples by the tables of ISO/IEC 14496-12; in each, nested entries of a name of four
# letters, a letter for the type, the size of one value and their number, padded to four bytes
# (github.com/gopro/gpmf-parser).

Stream = dict[str, "np.ndarray | str"]  # the entries of one sensor by name: (N, size) numbers, or text

MOST_SAMPLE = 1 << 24  # bytes of a sample, which is one second
MOST_SAMPLES = 100_000
MOST_LEVELS = 8  # of entries in entries; cameras write two
NUMBERS = {"b": "i1", "B": "u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8"}


def streams(path: Path) -> Iterator[Stream]:
    """Yield every sensor's entries of every sample of the video's GPMF track, in the file's order; none without such a
    track.

    Raises:
        DataFormatError: the track's tables or samples are damaged (the message does not name the file).
    """
    if not path.is_file():
        return
    try:
        with path.open("rb") as file:
            for sample in _samples(file):
                yield from _streams(sample)
    except (struct.error, IndexError, ValueError, OverflowError) as e:
        raise DataFormatError(f"its track of sensor data (GPMF) is damaged ({e})") from e


# ---- MP4: where the samples are --------------------------------------------------------------------------------------


def _samples(file: BinaryIO) -> Iterator[bytes]:
    """Yield each sample of the first `gpmd` track."""
    header = read_header(file)
    for start, end in boxes(header, 0, len(header), b"trak"):
        table = inside(header, start, end, b"mdia", b"minf", b"stbl")
        described = table and inside(header, *table, b"stsd")
        if table and described and header[described[0] + 12 : described[0] + 16] == b"gpmd":
            places = list(_places(header, *table))
            if sum(size for _, size in places) > file.seek(0, 2):
                raise ValueError("its samples claim more than the file holds")
            for offset, size in places:
                file.seek(offset)
                sample = file.read(size)
                if len(sample) < size:
                    raise ValueError("a sample lies behind the file's end")
                yield sample
            return


def _places(data: bytes, start: int, end: int) -> Iterator[tuple[int, int]]:
    """Offset in the file and size of each sample, from a track's tables: samples lie one after the other in chunks."""

    def table(kind: bytes, entry: str, skipped: int = 4) -> list[tuple]:
        found = inside(data, start, end, kind)
        if found is None:
            return []
        count = struct.unpack_from(">I", data, found[0] + skipped)[0]
        first, size = found[0] + skipped + 4, struct.calcsize(entry)
        if count > MOST_SAMPLES or first + count * size > found[1]:
            raise ValueError(f"its table '{kind.decode()}' claims {count} entries")
        return list(struct.iter_unpack(entry, data[first : first + count * size]))

    found = inside(data, start, end, b"stsz")
    if found is None:
        return
    same = struct.unpack_from(">I", data, found[0] + 4)[0]
    number = struct.unpack_from(">I", data, found[0] + 8)[0]
    if number > MOST_SAMPLES:
        raise ValueError(f"it claims {number} samples")
    sizes = [same] * number if same else [size for (size,) in table(b"stsz", ">I", 8)]
    if max(sizes, default=0) > MOST_SAMPLE:
        raise ValueError(f"a sample claims {max(sizes)} bytes")
    chunks = [offset for (offset,) in table(b"stco", ">I") or table(b"co64", ">Q")]
    runs = table(b"stsc", ">III")  # first chunk, samples in each, description
    if any(b <= a for (a, *_), (b, *_) in itertools.pairwise(runs)):
        raise ValueError("its table 'stsc' does not grow")
    k, run = 0, -1
    for chunk, offset in enumerate(chunks, 1):
        while run + 1 < len(runs) and runs[run + 1][0] <= chunk:
            run += 1
        for _ in range(runs[run][1] if run >= 0 else 1):
            if k == len(sizes):
                return
            yield offset, sizes[k]
            offset += sizes[k]
            k += 1


# ---- GPMF: what is in a sample ---------------------------------------------------------------------------------------


def _streams(sample: bytes, level: int = 1) -> Iterator[Stream]:
    """Yield the sensors (`STRM`) of every device (`DEVC`) in a sample."""
    if level > MOST_LEVELS:
        raise ValueError(f"its entries lie in each other, more than {MOST_LEVELS} deep")
    for name, kind, data, _ in _entries(sample):
        if name == "STRM":
            yield {n: _value(k, d, s) for n, k, d, s in _entries(data) if k in NUMBERS or k == "c"}
        elif kind == "\0":
            yield from _streams(data, level + 1)


def _entries(data: bytes) -> Iterator[tuple[str, str, bytes, int]]:
    """Name, type, bytes and size in bytes of one value of each entry."""
    at = 0
    while at + 8 <= len(data):
        name, kind, size, count = struct.unpack_from(">4scBH", data, at)
        end = at + 8 + size * count
        if end > len(data):
            raise ValueError(f"its entry {name!r} claims {size * count} bytes")
        yield name.decode("latin-1"), kind.decode("latin-1"), data[at + 8 : end], size
        at += 8 + (size * count + 3) // 4 * 4


def _value(kind: str, data: bytes, size: int) -> np.ndarray | str:
    if kind == "c":
        return data.decode("latin-1").rstrip("\0")
    numbers = np.frombuffer(data, NUMBERS[kind]).astype(np.float64)
    return numbers.reshape(-1, max(1, size // np.dtype(NUMBERS[kind]).itemsize))
