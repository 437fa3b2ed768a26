"""Progress of a call that says nothing itself."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Watch:
    """While a block keeps the main thread busy, reports count() of total, twice a second."""

    def __init__(self, count: Callable[[], int], total: int, progress: Callable[[int, int], None]):
        self._count = count
        self._total = total
        self._progress = progress
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._done.wait(0.5):
            self._progress(self._count(), self._total)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_) -> None:
        self._done.set()
        self._thread.join()
        self._progress(self._count(), self._total)
