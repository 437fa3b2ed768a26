"""Work on all cores: in order, with progress, and the first failure is the caller's."""

import os
import threading
import time

import pytest

from gof.host.threads import core_count, map_on_cores


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
