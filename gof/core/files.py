"""Files that a crash never leaves half of, and names from files that are not trusted."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import IO, Any

from .drafts import draft_of
from .errors import DataFormatError, GofError

try:
    locks = import_module("fcntl")
except ModuleNotFoundError:  # Windows
    locks = import_module("msvcrt")

LONGEST_NAME, LONGEST_PATH = 200, 1000  # bytes; room is left for what is put around a name, and for the folder
HALF_CHARACTER = re.compile(r"\\u[dD][89a-fA-F]")  # in JSON; alone it can be neither printed nor written
# Windows opens these as devices, in any case, with any ending.
DEVICE = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9\u00b9\u00b2\u00b3])(\..*)?", re.I)
LOCKED_BYTE = 2**30
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
NO_SYNC = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EROFS, errno.EACCES)


# ---------------------------------------------------------------- names


def is_name(name: str) -> bool:
    """Return whether a text may be one part of a path, on every system: a plain, printable name and nothing that acts.

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
    """Return whether a text is names joined by "/", of at most 1000 bytes."""
    return all(map(is_name, path.split("/"))) and len(path.encode("utf-8")) <= LONGEST_PATH


def path_in(folder: Path, path: str) -> Path:
    """Return the file that a name out of a file means: in `folder`, also after links are followed. It need not exist.

    Raises:
        DataFormatError: not names joined by "/", it leads out of the folder, or to a pipe or a device, which never end.
    """
    if not is_relative_path(path):
        raise DataFormatError(f"{str(folder)!r}: {path[:80]!r} cannot be the name of a file there")
    try:
        inside = (folder / path).resolve().is_relative_to(folder.resolve())
        plain = True
        with suppress(FileNotFoundError, NotADirectoryError):
            mode = (folder / path).stat().st_mode  # also asks the file system whether there can be such a name
            plain = stat.S_ISREG(mode) or stat.S_ISDIR(mode)
    except (OSError, RuntimeError) as e:  # too long, links in a circle
        raise DataFormatError(f"{str(folder)!r}: {path[:80]!r} cannot be the name of a file there ({e})") from e
    if not inside:
        raise DataFormatError(f"{str(folder)!r}: {path[:80]!r} points outside that folder; is it a link?")
    if not plain:
        raise DataFormatError(f"{str(folder)!r}: {path[:80]!r} is a pipe or a device, not a file")
    return folder / path


def without_place(path: Path, folder: Path) -> str:
    """Return the path relative to a folder, if they have more than the root of the disk in common; else its name alone.

    A published file says nothing of where its author keeps files.
    """
    path, folder = path.absolute(), folder.absolute()
    try:
        shared = Path(os.path.commonpath([path, folder]))
    except ValueError:  # on another drive
        return path.name
    return Path(os.path.relpath(path, folder)).as_posix() if shared != Path(shared.anchor) else path.name


def stamp(folder: Path, paths: Iterable[str]) -> str:
    """Sixteen hex digits that change with the names, sizes or times of change of files in a folder; absent ones count.

    Their content is not read: that would take minutes for a clip.
    """
    state = hashlib.sha256()
    for path in sorted(paths):
        try:
            status = (folder / path).stat()
            state.update(f"{path!r} {status.st_size} {status.st_mtime_ns}\n".encode())
        except OSError:
            state.update(f"{path!r} absent\n".encode())
    return state.hexdigest()[:16]


def digest(path: Path) -> str:
    """Sixteen hex digits that change with the content of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


# ---------------------------------------------------------------- writing


_named: set[Path] = set()  # links, as the user has written them


def follow_links_of(argv: Iterable[str]) -> None:
    """Remember the links that a command line names: an output of that name goes to where the link leads.

    Other links may have been made by other people, and are never written through.
    """
    words = [part for word in argv for part in (word, word.partition("=")[2]) if part]
    _named.update(path.absolute() for path in map(Path, words) if os.path.islink(path))


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path` (same suffix); rename it to `path` only if the block succeeds.

    The content is on the disk before it has its name: a power cut leaves the old file or the new one. A link is
    replaced, unless the user has named it; a device or a pipe stays, and gets the content at the end.

    Raises:
        IsADirectoryError: `path` is a folder.   GofError: it is a link in a circle.
    """
    if (number := _descriptor(path)) is not None:
        with _draft_elsewhere(path) as draft:
            yield draft
            sys.stdout.flush()
            sys.stderr.flush()
            _write_into(os.dup(number), draft, path)
        return
    if path.absolute() in _named:
        path = _end_of(path)
    if path.is_dir() and not path.is_symlink():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not path.is_symlink() and path.exists() and not path.is_file():
        with _draft_elsewhere(path) as draft:
            yield draft
            _write_into(os.open(path, os.O_WRONLY), draft, path)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = draft_of(path)
    temporary.unlink(missing_ok=True)  # a link of that name would be written through
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, path)
        _sync(path.parent)
    except OSError as e:
        if e.filename in (None, str(temporary)):  # a full disk does not say whose, and drafts are our own business
            e.filename, e.filename2 = str(path), None
        raise
    finally:
        temporary.unlink(missing_ok=True)


def holds_content(path: Path) -> bool:
    """Return whether writing to a path would replace something: not so for a device, a pipe, or this process' output,
    wherever that goes."""
    return (path.is_file() or path.is_dir()) and _descriptor(path) is None


def _descriptor(path: Path) -> int | None:
    """Return the number of an open file of this process that a path means, also by links: /dev/stdout is 1."""
    known = {"/dev/stdout": 1, "/dev/stderr": 2}
    place = os.path.abspath(path)
    for _ in range(40):  # as many as Linux follows
        if place in known:
            return known[place]
        if found := re.fullmatch(r"/(?:dev|proc/self)/fd/([0-9]{1,6})", place):
            return int(found[1])
        if not os.path.islink(place):
            return None
        place = os.path.abspath(os.path.join(os.path.dirname(place), os.readlink(place)))
    return None


def _end_of(path: Path) -> Path:
    """Return where a link leads; nothing need be there yet."""
    try:
        return path.resolve(strict=False)
    except (OSError, RuntimeError) as e:  # Python before 3.13 raises the second
        raise GofError(f"{path}: is a link that leads in a circle; remove it") from e


@contextmanager
def _draft_elsewhere(path: Path) -> Iterator[Path]:
    """Provide a name of the same suffix in a folder of its own, which goes at the end."""
    with tempfile.TemporaryDirectory(prefix="gof-") as folder:
        yield Path(folder) / f"draft{path.suffix}"


def _write_into(number: int, draft: Path, path: Path) -> None:
    """Copy a draft into an open file, and close that."""
    try:
        with os.fdopen(number, "wb") as out, draft.open("rb") as file:
            shutil.copyfileobj(file, out)
    except OSError as e:
        e.filename, e.filename2 = str(path), None
        raise


def require_replaceable(path: Path) -> None:
    """For outputs that other programs write: they put a new file in the place of what is there.

    Raises:
        GofError: there is a folder, a device or a pipe, also at the end of a link.
    """
    if path.exists() and not path.is_file():
        raise GofError(
            f"{path}: is not a file but {'a folder' if path.is_dir() else 'a device or a pipe'}; give another"
        )


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
    except OSError as e:
        if e.errno not in NO_SYNC:
            raise


@contextmanager
def only_run_in(folder: Path) -> Iterator[None]:
    """Hold a folder for one process; the system lets go of it when the process ends, however it ends.

    Where the file system has no locks this says so and goes on.

    Raises:
        GofError: another process works there, or the lock is a link to somewhere else.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _opened_lock(folder / ".lock") as lock:
        _lock(lock, folder)
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
        yield


def _opened_lock(path: Path) -> IO[str]:
    """Return the lock's file, made if absent. A link of its name is never followed, because the file is written."""
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as e:
        if e.errno == errno.ELOOP:
            raise GofError(f"{path}: is a link; remove it") from e
        raise
    return os.fdopen(number, "a+")


def _lock(lock: IO[str], folder: Path) -> None:
    try:
        if hasattr(locks, "flock"):
            locks.flock(lock, locks.LOCK_EX | locks.LOCK_NB)
        else:  # a byte behind the end, as no other process can read what is locked
            lock.seek(LOCKED_BYTE)
            locks.locking(lock.fileno(), locks.LK_NBLCK, 1)
    except (BlockingIOError, PermissionError) as e:
        lock.seek(0)
        raise GofError(
            f"{folder}: another run is at work there (process {lock.read().strip() or 'unknown'}); wait for it, or "
            "choose another --out"
        ) from e
    except OSError as e:
        if e.errno not in NO_LOCKS:
            raise
        print(f"{folder}: this file system has no locks; see to it that no other run works there", file=sys.stderr)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any, indent: int = 1) -> None:
    """Write JSON atomically; NaN and Inf are refused, because other readers reject them."""
    write_text(path, as_json(value, indent))


def as_json(value: Any, indent: int = 1) -> str:
    """Return the text that `write_json` writes. Raises ValueError: a number is NaN or Inf."""
    return json.dumps(value, indent=indent, allow_nan=False) + "\n"


def read_text(path: Path, errors: str = "strict") -> str:
    """Read text that people or other programs wrote: UTF-8, with or without a byte-order mark, and any line ends.

    Args:
        errors: as of `bytes.decode`, for what is not UTF-8.
    Raises:
        DataFormatError: the file is absent, cannot be read, or its text is not UTF-8 (names it).
    """
    if path.exists() and not path.is_file():
        raise DataFormatError(f"{path}: not a file")  # a device would never end
    try:
        data = path.read_bytes()
        if b"\0" in data[:4] or data.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise DataFormatError(f"{path}: its text is UTF-16 or UTF-32; save it as UTF-8 in your editor")
        return data.decode("utf-8-sig", errors).replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError as e:
        raise DataFormatError(f"{path}: no such file") from e
    except OSError as e:
        raise DataFormatError(f"{path}: cannot be read ({e.strerror})") from e
    except UnicodeDecodeError as e:
        raise DataFormatError(f"{path}: its text is not UTF-8 ({e}); save it as UTF-8 in your editor") from e


def read_json(path: Path) -> Any:
    """Read JSON; every number in it is finite, also as a float.

    Raises:
        DataFormatError: the file is absent or is not JSON (names it), or a number is none or beyond what a float holds
            (names the field).
    """
    text = read_text(path)
    try:
        value = json.loads(text, parse_int=_whole, object_pairs_hook=_object)
        if HALF_CHARACTER.search(text):
            json.dumps(value, ensure_ascii=False).encode("utf-8")  # fails where its other half is missing
        bad = _not_finite(value)
    except (ValueError, RecursionError) as e:  # broken, brackets without end
        if not text.strip():
            raise DataFormatError(f"{path}: not valid JSON: the file is empty; copy or write it again") from e
        remedy = "; was it cut off while being copied?" if isinstance(e, json.JSONDecodeError) else ""
        raise DataFormatError(f"{path}: not valid JSON ({e}){remedy}") from e
    if bad is not None:
        raise DataFormatError(
            f"{path}: not valid JSON: '{bad or 'all of it'}' is NaN, Inf or a number that no float holds; null "
            "stands for what is not known"
        )
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON. Raises ValueError: a name stands in it twice, of which one value would be lost."""
    value = dict(pairs)
    if len(value) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"'{twice[:80]}' stands twice in one object; remove one")
    return value


def _whole(digits: str) -> int | float:
    """Return a whole number of JSON; Inf where no float can hold it, as of other numbers."""
    return int(digits) if math.isfinite(float(digits)) else math.copysign(math.inf, float(digits))


def _not_finite(value: Any) -> str | None:
    """Return where the first number that is not finite stands, as "cameras[0].K[1][2]"; None where all are."""
    if isinstance(value, float):
        return None if math.isfinite(value) else ""
    parts: Iterable[tuple[Any, Any]] = enumerate(value) if isinstance(value, list) else ()
    for key, part in value.items() if isinstance(value, dict) else parts:
        if (inner := _not_finite(part)) is not None:
            place = f"[{key}]" if isinstance(value, list) else key[:80]
            return place + ("." if inner and not inner.startswith("[") else "") + inner
    return None
