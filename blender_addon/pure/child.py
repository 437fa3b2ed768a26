"""A worker of ours in another process of Blender: how it is called, and what it says while it works."""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from collections.abc import Iterable
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


class JobError(RuntimeError):
    """A process failed; the message says what it was doing, and why."""


def code(worker: str, arguments: list[str]) -> str:
    """Python code that runs a module of `worker` as the only work of a Blender process, and leaves it."""
    return (
        # Empty is the current folder, a user's, where a file `random.py` would be taken for Python's own.
        f"import sys; sys.path[:] = [{str(PACKAGE.parent)!r}, *filter(None, sys.path)]; "
        f"from {PACKAGE.name}.worker.{worker} import run; run({arguments!r})"
    )


def python() -> list[str]:
    """Return a command that runs what `code` gives in this Python, whose Blender is a module."""
    return [sys.executable, "-c"]


class WorkerMessages:
    """A worker's messages so far; a thread listens to it, so that `read` never waits.

    Attributes:
        done, total: parts of the stage's work, 0 before it says anything.
        peak_mb: its peak memory, known at its end.
    """

    def __init__(self, stream: Iterable[bytes] = ()):
        self.done = 0
        self.total = 0
        self.peak_mb = 0.0
        self._done_before: int | None = None
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._listener = threading.Thread(target=self._listen, args=(stream,), daemon=True)
        self._listener.start()

    @property
    def share(self) -> float:
        """Done of all, 0..1."""
        return min(self.done / self.total, 1.0) if self.total else 0.0

    @property
    def made(self) -> int:
        """Parts that this very process has made: it began where the one before it was stopped."""
        return self.done - (self._done_before or 0)

    def read(self) -> None:
        """Read the lines printed since the last call."""
        while not self._lines.empty():
            try:
                message = json.loads(self._lines.get().decode(errors="replace"))
            except ValueError:
                continue  # Blender's own greeting
            if not isinstance(message, dict):
                continue
            if progress := message.get("progress"):
                self.done = progress["done"]
                self.total = progress["total"]
                self._done_before = self.done if self._done_before is None else self._done_before
            self.peak_mb = message.get("cost", {}).get("peak_mb") or self.peak_mb

    def read_rest(self) -> None:
        """Read all remaining lines; only after the process has ended."""
        self._listener.join()
        self.read()

    def _listen(self, stream: Iterable[bytes]) -> None:
        for line in stream:
            self._lines.put(line)


def last_lines(path: Path, count: int = 12) -> str:
    """Return the end of a text file."""
    return "\n".join(path.read_text(encoding="utf-8", errors="replace").rstrip().split(os.linesep)[-count:])
