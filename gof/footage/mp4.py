"""MP4 and MOV files: the boxes of their table of contents (ISO/IEC 14496-12)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

MOST_HEADER = 1 << 28  # bytes of a file's table of contents; hours of footage have some 10 MB


def read_header(file: BinaryIO) -> bytes:
    """What the file's `moov` box holds; empty where there is none, as in a file that is no MP4.

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
    """First byte and end of what each box of this type holds, between two places."""
    while start + 8 <= end:
        size, kind = struct.unpack_from(">I4s", data, start)
        if not 8 <= size <= end - start:
            return
        if kind == wanted:
            yield start + 8, start + size
        start += size


def inside(data: bytes, start: int, end: int, *path: bytes) -> tuple[int, int] | None:
    """First byte and end of what the first box at this path holds; None where there is none."""
    for kind in path:
        box = next(boxes(data, start, end, kind), None)
        if box is None:
            return None
        start, end = box
    return start, end
