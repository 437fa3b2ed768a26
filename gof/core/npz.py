"""Reading of npz files that are not trusted: no pickles, and no more memory than its length explains."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np

from .errors import DataFormatError

# numpy and zipfile meet damage with many kinds of error, among them NotImplementedError, UnicodeError, and for a header
# that does not end, the tokenizer's own.
DAMAGE: tuple[type[Exception], ...] = (zipfile.BadZipFile, zlib.error, tokenize.TokenError, EOFError, ValueError)
DAMAGE += (OSError, RuntimeError, AttributeError, TypeError, KeyError, SyntaxError, OverflowError)
EXPANSION, ALWAYS = 100, 2**26  # an archive may unpack to this many times its size, or to this many bytes


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Return all arrays of an npz by name.

    Raises:
        DataFormatError: not an npz, cut off, arrays of objects (they would run code), a header that announces more than
            the file holds, or an archive that unpacks to more than 100 times its size.
    """
    try:
        shapes(path)
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
    except DataFormatError:
        raise
    except DAMAGE as e:
        raise DataFormatError(
            f"{path}: not a readable npz without pickles ({e}); truncated, or not an npz at all?"
        ) from e
    foreign = [
        name for name, value in arrays.items() if not isinstance(value, np.ndarray) or value.dtype.kind not in "biufU"
    ]
    if foreign:
        raise DataFormatError(f"{path}: fields {foreign} hold neither numbers nor text")
    return arrays


def read_npy(path: Path) -> np.ndarray:
    """Return the array of an npy.

    Raises:
        DataFormatError: absent, not an npy, cut off, of objects, or a header that announces more than the file holds.
    """
    try:
        with open(path, "rb") as file:
            shape, dtype = _header(file, path.stat().st_size)
            if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > path.stat().st_size:
                raise ValueError(f"it announces shape {shape} of {dtype} in {path.stat().st_size} bytes")
        return np.load(path, allow_pickle=False)
    except DAMAGE as e:
        raise DataFormatError(f"{path}: not a readable npy ({e})") from e


def _header(file: IO[bytes], size: int) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of the npy of `size` bytes. Raises ValueError: its header announces to be longer than that."""
    version = np.lib.format.read_magic(file)
    short = version == (1, 0)
    begin = file.tell()
    length = int.from_bytes(file.read(2 if short else 4), "little")
    if length > size:
        raise ValueError(f"its header announces {length} bytes, it has {size}")
    file.seek(begin)
    read = np.lib.format.read_array_header_1_0 if short else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return shape, dtype


def shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Shapes of an npz's arrays by name, from the headers alone.

    Raises:
        DataFormatError: an array is announced to be more than the file holds, or the archive unpacks to more than 100
            times its size.   One of DAMAGE: it is no npz.
    """
    found = {}
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        total, limit = sum(m.file_size for m in members), max(EXPANSION * path.stat().st_size, ALWAYS)
        if total > limit:
            raise DataFormatError(
                f"{path}: unpacks to {total} bytes from {path.stat().st_size}; nothing honest is packed so tightly"
            )
        for member in members:
            with archive.open(member) as file:
                shape, dtype = _header(file, member.file_size)
            if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > member.file_size:
                raise DataFormatError(
                    f"{path}: '{member.filename}' announces shape {shape} of {dtype}, the file holds "
                    f"{member.file_size} bytes of it"
                )
            found[member.filename.removesuffix(".npy")] = shape
    return found
