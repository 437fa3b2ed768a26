"""Parts of a kernel's work on Dr.Jit's own threads, at most MOST of them.

Dr.Jit's threads go on looking for work for some milliseconds after each of its kernels. Threads of our own would share
the cores with them: on two cores a training step then takes 1.4 times as long. So parts are given to Dr.Jit's threads,
by the C functions of its thread pool (libnanothread in Dr.Jit's package, declared in its
include/nanothread/nanothread.h); the caller works too while it waits. Where that library is not found, Python's threads
do the work.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path

import drjit as dr
import numpy as np

MOST = 16  # each has gradient sums of its own, 64 bytes per Gaussian
PART = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_void_p)  # of the number of a part; no payload
LIBRARY = {"win32": "nanothread.dll", "darwin": "libnanothread.dylib"}.get(sys.platform, "libnanothread.so")


def thread_count() -> int:
    return max(1, min(dr.thread_count(), MOST))


def even_parts(n: int, parts: int) -> list[tuple[int, int]]:
    """[begin, end) of about equal length that cover [0, n)."""
    ends = [n * k // parts for k in range(parts + 1)]
    return [(a, b) for a, b in pairwise(ends) if a < b]


def run(function: Callable, tasks: Iterable[tuple]) -> None:
    """function(*task) for each; returns when all are done, or raises what the first that raised did.

    A thread that is done holds no array: the last reference to one of Dr.Jit's must not go on a thread other than the
    caller's, because releasing it waits for Dr.Jit's lock, which the caller may hold while it waits for Python's.
    """
    tasks, threads = list(tasks), thread_count()
    if threads == 1 or len(tasks) <= 1:
        for task in tasks:
            function(*task)
        return
    lent, raised = [function], []

    def one(number: int) -> None:
        try:
            lent[0](*tasks[number])
        except BaseException as e:  # Ctrl-C, too, is for the caller: C code cannot pass it on
            raised.append(e)

    try:
        pool = _drjit_pool()
        if pool is None:
            list(_own_pool(threads).map(one, range(len(tasks))))
        else:
            _on(pool, one, len(tasks))
    finally:
        lent.clear()
    if raised:
        raise raised[0]


def _on(pool: ctypes.CDLL, function: Callable[[int], None], parts: int) -> None:
    """function(k) for k < parts on Dr.Jit's threads and this one."""
    called = PART(lambda number, _: function(number))
    pool.task_wait_and_release(pool.task_submit_dep(None, None, 0, parts, called, None, 0, None, 1, 0))


@cache
def _drjit_pool() -> ctypes.CDLL | None:
    """Functions of the thread pool that Dr.Jit uses; None where they are not found."""
    try:
        library = ctypes.CDLL(str(Path(dr.__file__).parent / LIBRARY))
        submit, wait = library.task_submit_dep, library.task_wait_and_release
    except (OSError, AttributeError):
        return None
    # Pool (none: the default one, which is Dr.Jit's), parents and their number, parts, function, its payload, the
    # payload's size and destructor, whether a single part may not be done at once, whether to take the time.
    address, number = ctypes.c_void_p, ctypes.c_uint32
    flag = ctypes.c_int
    submit.argtypes = [address, address, number, number, PART, address, number, address, flag, flag]
    submit.restype = address
    wait.argtypes, wait.restype = [address], None
    # These threads take numbers below 1e-38 for 0, of which numpy would warn when numba asks it for the smallest, while
    # it compiles there; what numpy has once found it keeps.
    np.finfo(np.float32), np.finfo(np.float64)
    return library


@cache
def _own_pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="gof-render")
