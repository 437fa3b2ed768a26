"""Compile the native kernels: once per machine, kept in the user's cache folder, and announced."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

import numba
from numba.core import config, event

# Floating-point liberties that keep results well defined: fused multiply-add, and no care for the sign of zero.
FAST = {"contract", "nsz", "arcp"}


def cache_folder() -> Path | None:
    """Return the compiled kernels' folder; None where none can be written: every process then compiles them.

    $NUMBA_CACHE_DIR, or gof in the user's cache folder. The last part names the sources, because numba notices a change
    only in the file that holds a kernel and not in those it calls.
    """
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gof"
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or user) / f"kernels-{hashlib.sha256(sources).hexdigest()[:12]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


CACHE = cache_folder()
WHERE = f"kept in {CACHE}" if CACHE else "in every process anew: no cache folder can be written (XDG_CACHE_HOME)"


def kernel(function):
    """Make a function one that numba compiles for the types it is called with; it runs without Python's lock."""
    elsewhere = config.CACHE_DIR
    config.CACHE_DIR = str(CACHE or "")  # read while the function is wrapped; other users of numba keep theirs
    try:
        options = {"nogil": True, "error_model": "numpy", "boundscheck": False, "fastmath": FAST}
        return numba.njit(cache=CACHE is not None, **options)(function)
    finally:
        config.CACHE_DIR = elsewhere


def part(function):
    """Make a function a part of the kernels that call it."""
    return numba.njit(forceinline=True, error_model="numpy", boundscheck=False, fastmath=FAST)(function)


class _Announcement(event.Listener):
    """Tells the user, once per process, why the first picture takes seconds."""

    def __init__(self):
        self.made = False

    def on_start(self, started: event.Event) -> None:
        ours = getattr(started.data.get("dispatcher"), "__module__", "").startswith(__package__)
        if ours and not self.made:
            self.made = True
            print(f"gof: compiling the renderer for this CPU, some seconds, {WHERE}", file=sys.stderr, flush=True)

    def on_end(self, ended: event.Event) -> None:
        """Nothing to say."""


event.register("numba:compile", _Announcement())
