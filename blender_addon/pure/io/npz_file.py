"""Arrays of an npz file, with numpy only: no pickles, and no more memory than its length explains."""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path

import numpy as np

from . import FileFormatError

EXPANSION, ALWAYS = 100, 2**26  # an archive may unpack to this many times its size, or to this many bytes
# What numpy and zipfile raise when a file is damaged.
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    ValueError,
    OSError,
    RuntimeError,
    AttributeError,
    TypeError,
    KeyError,
    SyntaxError,
    OverflowError,
)


def arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays by name.

    Raises:
        FileFormatError: not an npz, cut off, arrays of objects, a header that announces more than the file holds, or an
            archive that unpacks to more than 100 times its size.
    """
    try:
        shapes(path)
        with np.load(path, allow_pickle=False) as data:
            return {key: data[key] for key in data.files if isinstance(data[key], np.ndarray)}
    except DAMAGE as error:
        raise FileFormatError(f"{path}: not a readable npz ({error}); truncated, or another kind of file?") from None


def shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Shapes by name, from the headers alone. Raises: one of DAMAGE."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > max(EXPANSION * path.stat().st_size, ALWAYS):
            raise ValueError("packed more tightly than anything honest")
        for member in archive.infolist():
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(file)
            if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > member.file_size:
                raise ValueError(f"'{member.filename}' announces shape {shape}, more than the file holds")
            found[member.filename.removesuffix(".npy")] = shape
    return found
