"""Writing files so that a crash never leaves half of one."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gof.errors import DataFormatError, GofError


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path` (same suffix); rename it to `path` only if the block succeeds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as e:
        e.filename = e.filename or str(path)  # a full disk does not say whose
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def only_run_in(folder: Path) -> Iterator[None]:
    """Hold a folder for one process; the system lets go of it when the process ends, however it ends.

    Raises:
        GofError: another process works there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as e:
            lock.seek(0)
            raise GofError(
                f"{folder}: another run is at work there (process {lock.read().strip() or 'unknown'}); wait for it, or "
                "choose another --out"
            ) from e
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
        yield


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically; NaN and Inf are refused, because other readers reject them."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Read JSON.

    Raises:
        DataFormatError: the file is absent or is not JSON (names it).
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as e:
        raise DataFormatError(f"{path}: no such file") from e
    except OSError as e:
        raise DataFormatError(f"{path}: cannot be read ({e.strerror})") from e
    except (ValueError, RecursionError) as e:  # broken, not UTF-8, numbers of thousands of digits, brackets without end
        raise DataFormatError(f"{path}: not valid JSON ({e}); was it cut off while being copied?") from e
