"""Files that a crash never leaves half of, and names from files that nobody vouches for.

`gof.core.files` decides the same about names; this module needs nothing but the standard library.
"""

from __future__ import annotations

import errno
import json
import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from . import FileFormatError

LONGEST_NAME, LONGEST_PATH = 200, 1000  # bytes; room is left for what is put around a name, and for the folder
HALF_CHARACTER = re.compile(r"\\u[dD][89a-fA-F]")  # in JSON; alone it can be neither printed nor written
NO_SYNC = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EROFS, errno.EACCES)
# Windows opens these as devices, in any case, with any ending.
DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9\u00b9\u00b2\u00b3])(\..*)?", re.I)
FRAME = re.compile(r"\{frame(?::0?[1-9]d)?\}")  # what a pattern may hold where the frame's number goes


def is_name(name: str) -> bool:
    """Whether a text may be one part of a path, on every system: a plain, printable name and nothing that acts.

    Refused are separators, "." and "..", drives and streams, wildcards, devices, what shells and options begin with,
    braces (Python's formats), control characters, line ends, text that is not UTF-8, and names of more than 200 bytes.
    """
    return (
        name.isprintable()
        and 0 < len(name.encode("utf-8")) <= LONGEST_NAME
        and not set(name) & set('/\\:*?"<>|{}')
        and not name.startswith(("-", "~"))
        and not name.endswith((".", " "))
        and not DEVICE.fullmatch(name)
    )


def is_relative_path(path: str) -> bool:
    """Whether a text is names joined by "/", of at most 1000 bytes."""
    return all(map(is_name, path.split("/"))) and len(path.encode("utf-8")) <= LONGEST_PATH


def is_pattern(path: str) -> bool:
    """Whether a text is a relative path once its `{frame:06d}` is a number."""
    return is_relative_path(FRAME.sub("0", path))


def path_in(folder: Path, path: str) -> Path:
    """The file that a name out of a file means: in `folder`, also after links are followed. It need not exist.

    Raises:
        FileFormatError: not names joined by "/", it leads out of the folder, or to a pipe or a device, which never end.
    """
    if not is_relative_path(path):
        raise FileFormatError(f"{str(folder)!r}: {path[:80]!r} cannot be the name of a file there")
    try:
        inside = (folder / path).resolve().is_relative_to(folder.resolve())
        plain = True
        with suppress(FileNotFoundError, NotADirectoryError):
            mode = (folder / path).stat().st_mode  # also asks the file system whether there can be such a name
            plain = stat.S_ISREG(mode) or stat.S_ISDIR(mode)
    except (OSError, RuntimeError) as error:  # too long, links in a circle
        raise FileFormatError(f"{str(folder)!r}: {path[:80]!r} cannot be the name of a file there ({error})") from None
    if not inside:
        raise FileFormatError(f"{str(folder)!r}: {path[:80]!r} points outside that folder; is it a link?")
    if not plain:
        raise FileFormatError(f"{str(folder)!r}: {path[:80]!r} is a pipe or a device, not a file")
    return folder / path


def temporary(path: Path) -> Path:
    """A name beside `path` with its suffix, for what is not finished: the same in every run, so that none piles up."""
    return path.with_name(f".tmp-{path.name}")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; rename it to `path` only if the block succeeds. Makes the folder.

    The content is on the disk before it has its name: a power cut leaves the old file or the new one.

    Raises:
        FileFormatError: there is a folder, a device or a pipe, which would be lost.
    """
    if not path.is_symlink() and path.exists() and not path.is_file():
        raise FileFormatError(f"{path}: is not a file but {'a folder' if path.is_dir() else 'a device or a pipe'}")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = temporary(path)
    draft.unlink(missing_ok=True)  # a link of that name would be written through
    try:
        yield draft
        _sync(draft)
        os.replace(draft, path)
        _sync(path.parent)
    finally:
        draft.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk, where the system can say so."""
    if path.is_dir() and os.name != "posix":
        return
    try:
        number = os.open(path, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, atomically."""
    with atomic_path(path) as draft:
        draft.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with atomic_path(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_json(path: Path, data: Any, indent: int = 1) -> None:
    """Write JSON, atomically; NaN and Inf are refused, because other readers reject them."""
    write_text(path, json.dumps(data, indent=indent, allow_nan=False) + "\n")


def read_text(path: Path, errors: str = "strict") -> str:
    """Read text that people or other programs wrote: UTF-8, with or without a byte-order mark, and any line ends.

    Args:
        errors: as of `bytes.decode`, for what is not UTF-8.
    Raises:
        FileFormatError: the file is absent, cannot be read, or its text is not UTF-8 (names it).
    """
    if path.exists() and not path.is_file():
        raise FileFormatError(f"{path}: not a file")  # a device would never end
    try:
        data = path.read_bytes()
        if b"\0" in data[:4] or data.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise FileFormatError(f"{path}: its text is UTF-16 or UTF-32; save it as UTF-8 in your editor")
        return data.decode("utf-8-sig", errors).replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: its text is not UTF-8 ({error}); save it as UTF-8 in your editor") from None


def read_json(path: Path) -> Any:
    """Read JSON; every number in it is finite, also as a float.

    Raises:
        FileFormatError: the file is absent or is not JSON (names it), or a number is none or beyond what a float holds
            (names the field).
    """
    text = read_text(path)
    try:
        value = json.loads(text, parse_int=_whole, object_pairs_hook=_object)
        if HALF_CHARACTER.search(text):
            json.dumps(value, ensure_ascii=False).encode("utf-8")  # fails where its other half is missing
        bad = _not_finite(value)
    except (ValueError, RecursionError) as error:  # broken, brackets without end
        if not text.strip():
            raise FileFormatError(f"{path}: not readable as JSON: the file is empty; copy or write it again") from None
        remedy = "; was it cut off while being copied?" if isinstance(error, json.JSONDecodeError) else ""
        raise FileFormatError(f"{path}: not readable as JSON ({error}){remedy}") from None
    if bad is not None:
        raise FileFormatError(
            f"{path}: not readable as JSON: '{bad or 'all of it'}' is NaN, Inf or a number that no float holds; null "
            "stands for what is not known"
        )
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON. Raises ValueError: a name stands in it twice, of which one value would be lost."""
    value = dict(pairs)
    if len(value) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"'{twice[:80]}' stands twice in one object; remove one")
    return value


def _whole(digits: str) -> int | float:
    """A whole number of JSON; Inf where no float can hold it, as of other numbers."""
    return int(digits) if math.isfinite(float(digits)) else math.copysign(math.inf, float(digits))


def _not_finite(value: Any) -> str | None:
    """Where the first number that is not finite stands, as "cameras[0].K[1][2]"; None where all are."""
    if isinstance(value, float):
        return None if math.isfinite(value) else ""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        if (inner := _not_finite(part)) is not None:
            here = f"[{key}]" if isinstance(value, list) else key[:80]
            return here + ("." if inner and not inner.startswith("[") else "") + inner
    return None
