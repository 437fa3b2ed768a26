"""OpenEXR pictures of named channels, by numpy and zlib alone: scan lines, not compressed or by ZIP.

The layout is that of "OpenEXR File Layout": a header of attributes, a table of offsets, and blocks of lines in which
channels follow each other in the order of their names.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .errors import DataFormatError, GofError
from .files import write_bytes

MAGIC = b"\x76\x2f\x31\x01"
LINES = {0: 1, 2: 1, 3: 16}  # of a block, by compression: none, ZIPS, ZIP
TYPES: dict[int, np.dtype] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
MOST_PIXELS = 1 << 28  # a header that says more is damaged
NOT_PLAIN = 0x1E00  # bits of the version: tiles, long names, deep, several parts
LONG_NAMES = 0x400


def write_exr(path: Path, channels: Mapping[str, np.ndarray], notes: Mapping[str, str] | None = None) -> None:
    """Write channels (H, W) as 32-bit floats, ZIP-compressed, atomically.

    Args:
        channels: name -> values; all of one shape.   notes: name -> text, kept in the header.
    """
    names = sorted(channels)
    height, width = channels[names[0]].shape
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", 2, 0, 1, 1) for name in names) + b"\0"
    header = [
        _attribute("channels", "chlist", listed),
        _attribute("compression", "compression", b"\x03"),
        _attribute("dataWindow", "box2i", box),
        _attribute("displayWindow", "box2i", box),
        _attribute("lineOrder", "lineOrder", b"\0"),
        _attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        _attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
        *(_attribute(name, "string", text.encode()) for name, text in sorted((notes or {}).items())),
    ]
    start = MAGIC + struct.pack("<i", 2) + b"".join(header) + b"\0"
    lines = np.stack([np.asarray(channels[name], "<f4") for name in names], 1)  # (H, C, W)
    blocks = []
    for top in range(0, height, LINES[3]):
        plain = lines[top : top + LINES[3]].tobytes()
        packed = zlib.compress(_predicted(plain))
        data = packed if len(packed) < len(plain) else plain  # as readers expect it: what does not shrink stays
        blocks.append(struct.pack("<ii", top, len(data)) + data)
    sizes = [len(block) for block in blocks]
    offsets = len(start) + 8 * len(blocks) + np.cumsum([0, *sizes[:-1]])
    write_bytes(path, start + offsets.astype("<u8").tobytes() + b"".join(blocks))


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Return the channels of a picture by name, (H, W) each, of the type that the file has.

    Raises:
        DataFormatError: no such file, no OpenEXR, damaged, or of a kind that is not read here (tiles, several parts,
            other compressions, subsampled channels).
    """
    try:
        data = path.read_bytes()
    except OSError as e:
        raise DataFormatError(f"{path}: {e.strerror}") from e
    try:
        return _channels(data)
    except GofError as e:
        raise DataFormatError(f"{path}: {e}") from e
    except (struct.error, ValueError, IndexError, KeyError, UnicodeDecodeError, zlib.error) as e:
        raise DataFormatError(f"{path}: a damaged OpenEXR file ({type(e).__name__}: {e})") from e


def _channels(data: bytes) -> dict[str, np.ndarray]:
    if data[:4] != MAGIC:
        raise DataFormatError("is no OpenEXR file")
    flags = struct.unpack_from("<i", data, 4)[0] & ~0xFF
    if flags & NOT_PLAIN & ~LONG_NAMES:
        raise DataFormatError("has tiles, deep pixels or several parts; only single pictures of scan lines are read")
    header, at = _header(data)
    compression = header["compression"][0]
    if compression not in LINES:
        raise DataFormatError(f"has compression {compression}; none, ZIPS and ZIP are read (0, 2, 3)")
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if not (width > 0 and height > 0 and width * height <= MOST_PIXELS):
        raise DataFormatError(f"says that it has {width} x {height} pixels")
    kinds = _listed(header["channels"])
    line = sum(kind.itemsize for kind in kinds.values()) * width
    found = {name: np.zeros((height, width), kind) for name, kind in kinds.items()}
    blocks = -(-height // LINES[compression])
    seen = np.zeros(height, bool)
    for offset in struct.unpack_from(f"<{blocks}Q", data, at):
        first, size = struct.unpack_from("<ii", data, offset)
        row = first - top
        count = min(LINES[compression], height - row)
        if not 0 <= row < height or seen[row]:
            raise DataFormatError(f"has a block of lines at {first}, outside the picture or twice")
        packed = data[offset + 8 : offset + 8 + size]
        plain = packed
        if compression and size < count * line:
            plain = _unpredicted(zlib.decompressobj().decompress(packed, count * line))
        if len(plain) != count * line:
            raise DataFormatError(f"has {len(plain)} bytes of lines {first} on, expected {count * line}; cut off?")
        for k in range(count):
            place = k * line
            for name, kind in kinds.items():
                found[name][row + k] = np.frombuffer(plain, kind, width, place)
                place += width * kind.itemsize
            seen[row + k] = True
    if not seen.all():
        raise DataFormatError(f"lacks {int((~seen).sum())} of its {height} lines")
    return found


def _header(data: bytes) -> tuple[dict[str, bytes], int]:
    """Return the attributes by name, and where they end."""
    found, at = {}, 8
    while data[at] != 0:
        name, at = _word(data, at)
        _, at = _word(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        found[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
        if size < 0 or at >= len(data):
            raise DataFormatError("ends in its header")
    return found, at + 1


def _listed(data: bytes) -> dict[str, np.dtype]:
    """Return the type of each channel, in the file's order."""
    found: dict[str, np.dtype] = {}
    at = 0
    while data[at] != 0:
        name, at = _word(data, at)
        kind, *steps = struct.unpack_from("<iB3xii", data, at)
        if steps[1:] != [1, 1]:
            raise DataFormatError(f"channel '{name}' is subsampled")
        found[name] = TYPES[kind]
        at += 16
    return found


def _word(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def _attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def _predicted(plain: bytes) -> bytes:
    """Return what ZIP packs: even bytes before odd ones, each as its difference to the one before, plus 128."""
    values = np.frombuffer(plain, np.uint8)
    values = np.concatenate([values[::2], values[1::2]])
    return np.concatenate([values[:1], np.diff(values) + np.uint8(128)]).tobytes()


def _unpredicted(packed: bytes) -> bytes:
    """Return the inverse of `_predicted`."""
    values = np.frombuffer(packed, np.uint8).copy()
    values[1:] += np.uint8(128)
    values = np.cumsum(values, dtype=np.uint8)
    plain, half = np.empty_like(values), (len(values) + 1) // 2
    plain[::2], plain[1::2] = values[:half], values[half:]
    return plain.tobytes()
