"""Writing files so that a crash never leaves half of one: under a temporary name beside it, renamed when complete."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from . import FileFormatError


def temporary(path: Path) -> Path:
    """A name beside `path` with its suffix, for what is not finished: the same in every run, so that none piles up."""
    return path.with_name(f".tmp-{path.name}")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; rename it to `path` only if the block succeeds. Makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = temporary(path)
    try:
        yield draft
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


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


def read_json(path: Path) -> Any:
    """Read JSON. Raises FileFormatError: the file is absent, or is not JSON (names it)."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:  # broken, not UTF-8, brackets without end
        raise FileFormatError(f"{path}: not readable as JSON ({error}); was it cut off while being copied?") from None
