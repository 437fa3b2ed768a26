"""Parts of a kernel's work on several threads: as many as Dr.Jit uses, at most MOST."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import drjit as dr

MOST = 16  # each has gradient sums of its own, 64 bytes per Gaussian


def thread_count() -> int:
    return max(1, min(dr.thread_count(), MOST))


def even_parts(n: int, parts: int) -> list[tuple[int, int]]:
    """[begin, end) of about equal length that cover [0, n)."""
    ends = [n * k // parts for k in range(parts + 1)]
    return [(a, b) for a, b in pairwise(ends) if a < b]


def run(function: Callable, tasks: Iterable[tuple]) -> None:
    """function(*task) for each; returns when all are done, or raises what one raised.

    A thread that is done holds no array: the last reference to one of Dr.Jit's must not go on a thread other than the
    caller's, because releasing it waits for Dr.Jit's lock, which the caller may hold while it waits for Python's.
    """
    tasks, threads = list(tasks), thread_count()
    if threads == 1 or len(tasks) == 1:
        for task in tasks:
            function(*task)
        return
    lent = [function]
    try:
        list(_pool(threads).map(lambda task: lent[0](*task), tasks))
    finally:
        lent.clear()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="gof-render")
