"""Names of what is not finished, and the end of what killed runs left of it."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

HOST = hashlib.sha256(platform.node().encode()).hexdigest()[:8]  # other computers may write into the same folder
DRAFT = re.compile(r"\..+\.([0-9a-f]{8})-([0-9]{1,10})\.partial(\.[^.]*)?")
LONG_S = 86400.0  # after which a draft of another computer is taken for left behind
_cleaned: set[Path] = set()  # folders in which this process has looked for drafts


def draft_of(path: Path) -> Path:
    """Return a name beside `path`, with its ending, that no other run uses.

    The first time in a folder, drafts there are removed whose run has ended: no command comes back to them.
    """
    folder = path.parent.absolute()
    if folder not in _cleaned:
        _cleaned.add(folder)
        remove_drafts(folder)
    return path.with_name(f".{path.stem}.{HOST}-{os.getpid()}.partial{path.suffix}")


def remove_drafts(folder: Path) -> None:
    """Remove the drafts in a folder whose run has ended; those that cannot be removed stay."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            found = DRAFT.fullmatch(entry.name)
            with suppress(OSError):
                if found and _is_left(found[1], int(found[2]), entry.stat(follow_symlinks=False).st_mtime):
                    remove(Path(entry.path))


def remove(path: Path) -> None:
    """Remove a file, a link or a folder, where there is one."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder beside `path`; it becomes `path`, which must not exist, only if the block succeeds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = draft_of(path)
    remove(draft)
    draft.mkdir()
    try:
        yield draft
        os.replace(draft, path)
    finally:
        remove(draft)


def _is_left(host: str, process: int, changed_s: float) -> bool:
    """Return whether the run that made a draft has ended."""
    if host != HOST or os.name != "posix":  # elsewhere there is no asking that does no harm
        return time.time() - changed_s > LONG_S
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # it runs, and is somebody else's
        return False
    return False
