"""Work on all cores: in order, with progress, and the first failure is the caller's."""

import os
import threading
import time

import pytest

from gof.host.threads import AHEAD, core_count, map_beside, map_on_cores


def test_results_keep_their_order_whoever_is_done_first():
    def slow_first(n):
        time.sleep(0.05 if n == 0 else 0)
        return n * n

    told = []
    assert map_on_cores(slow_first, range(5), lambda done, total: told.append((done, total))) == [0, 1, 4, 9, 16]
    assert told == [(k, 5) for k in range(1, 6)]
    assert map_on_cores(slow_first, []) == []


def test_progress_is_told_in_the_callers_thread():
    threads = set()
    map_on_cores(lambda n: n, range(8), lambda *_: threads.add(threading.current_thread()))
    assert threads == {threading.current_thread()}


def test_the_first_failure_is_raised_and_what_waits_does_not_begin(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    begun = []

    def fail(n):
        begun.append(n)
        time.sleep(0.05)
        raise ValueError(f"frame {n}")

    with pytest.raises(ValueError, match="frame 0"):
        map_on_cores(fail, range(50))
    assert len(begun) < 4


@pytest.mark.parametrize(
    ("asked", "most"), [("1", 1), (" 1,4", 1), ("100000", 10**9), ("", 10**9), ("\u00b2", 10**9), ("0", 10**9)]
)
def test_a_user_may_ask_for_fewer_cores(monkeypatch, asked, most):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    own = core_count()
    assert 1 <= own <= os.cpu_count()
    monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert core_count() == min(own, most)


def test_beside_the_caller_makes_items_while_results_come_in_order():
    made, makers, workers = [], set(), set()

    def items():
        for n in range(6):
            makers.add(threading.current_thread())
            made.append(n)
            yield n

    def square(n):
        workers.add(threading.current_thread())
        return n * n

    results = map_beside(square, items())
    assert next(results) == 0
    assert len(made) == 1 + AHEAD  # not all of them: pictures are large
    assert list(results) == [1, 4, 9, 16, 25]
    assert makers == {threading.current_thread()} and len(workers) == 1 and not makers & workers


def test_beside_a_failure_ends_both():
    def fail(n):
        raise ValueError(f"picture {n}")

    made = []
    with pytest.raises(ValueError, match="picture 0"):
        list(map_beside(fail, (made.append(n) or n for n in range(50))))
    assert len(made) <= 2 + AHEAD
