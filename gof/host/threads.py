"""Frames side by side on the computer's cores: numpy, scipy and OpenCV let go of Python's lock while they work."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
AHEAD = 2  # items that wait for `map_beside`: pictures are large


def core_count() -> int:
    """Return how many cores this process may use: OMP_NUM_THREADS (of "4,2" the first) where that is fewer.

    One that is no number from 1 on counts as none; `gof.render.backend` refuses it by name.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(cores, int(asked)) if asked.isascii() and asked.isdigit() and int(asked) > 0 else cores


def map_on_cores(
    function: Callable[[T], R], items: Iterable[T], progress: Callable[[int, int], object] | None = None
) -> list[R]:
    """Return function(item) of each, in order; the work of one must not depend on another's.

    Args:
        progress: called with (done, total), in the caller's thread, whenever the next in order is done.
    Raises:
        whatever the first of them in order that failed raised; those that had not begun do not begin.
    """
    items, done = list(items), []
    with ThreadPoolExecutor(max(1, min(core_count(), len(items)))) as pool:
        try:
            for result in pool.map(function, items):
                done.append(result)
                if progress:
                    progress(len(done), len(items))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return done


def map_beside(function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield function(item) of each, in order; a thread does that while the caller's makes the next items.

    For items that only the caller's thread may make, as Dr.Jit's pictures, and are not all to be held at once.

    Raises:
        whatever making an item or the function raised; what waits does not begin.
    """
    waiting: deque[Future[R]] = deque()
    with ThreadPoolExecutor(1) as beside:
        try:
            for item in items:
                waiting.append(beside.submit(function, item))
                if len(waiting) > AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            beside.shutdown(cancel_futures=True)
