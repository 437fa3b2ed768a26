"""The generator's workers on this machine: order, retries, and an end that is one."""

import subprocess
import sys
import threading
import time

import pytest

from gof_benchmark.generator import blender_process
from gof_benchmark.generator.workers import RETRIES, LocalWorkers


@pytest.fixture
def one():
    """One worker, and what holds it until it is set."""
    go = threading.Event()
    with LocalWorkers(1) as workers:
        started = threading.Event()
        workers.submit(lambda: (started.set(), go.wait(60)))
        assert started.wait(60)
        yield workers, go
        go.set()


def test_the_highest_priority_is_next_and_of_equals_the_first(one):
    workers, go = one
    order = []
    asked = [(0, "a"), (-1, "late"), (0, "b"), (1, "first"), (-1, "last")]
    futures = [workers.submit(order.append, name, priority=priority) for priority, name in asked]
    go.set()
    for future in futures:
        future.result(timeout=60)
    assert order == ["first", "a", "b", "late", "last"]


def test_a_task_is_tried_again_and_its_last_error_is_the_answer():
    tries = []

    def fails(times: int) -> int:
        tries.append(times)
        if len(tries) <= times:
            raise ValueError(f"try {len(tries)}")
        return len(tries)

    with LocalWorkers(2) as workers:
        assert workers.submit(fails, RETRIES).result(timeout=60) == RETRIES + 1
        tries.clear()
        with pytest.raises(ValueError, match=f"try {RETRIES + 1}"):
            workers.submit(fails, 100).result(timeout=60)
    assert len(tries) == RETRIES + 1


def test_two_workers_work_at_the_same_time():
    both = threading.Barrier(2, timeout=60)
    with LocalWorkers(2) as workers:
        futures = [workers.submit(both.wait) for _ in range(2)]
        assert {future.result(timeout=60) for future in futures} == {0, 1}


def test_a_cancelled_task_never_runs(one):
    workers, go = one
    ran = []
    waiting, after = workers.submit(ran.append, "cancelled"), workers.submit(ran.append, "after")
    assert waiting.cancel()
    go.set()
    after.result(timeout=60)
    assert ran == ["after"]


def test_who_leaves_ends_what_works_and_it_is_not_tried_again(tmp_path, monkeypatch):
    """A stage of two minutes, in place of a bake."""
    sleeper = [sys.executable, "-c", "import time; time.sleep(120)"]
    begun = []
    monkeypatch.setattr(blender_process, "command", lambda stage, root: begun.append(stage) or sleeper)
    with LocalWorkers(1) as workers:
        future = workers.submit(blender_process.run_stage, "bake", tmp_path)
        deadline = time.monotonic() + 60
        while not blender_process._started.get(tmp_path):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        workers.leave(tmp_path)
        with pytest.raises(blender_process.BlenderLost, match="status -9"):
            future.result(timeout=60)
    assert begun == ["bake"]


def test_a_run_that_fails_ends_although_a_worker_is_busy():
    """Nobody waits at the end of the program for a thread that waits for a Blender."""
    program = (
        "import time\n"
        "from gof_benchmark.generator.workers import LocalWorkers\n"
        "with LocalWorkers(1) as workers:\n"
        "    busy = workers.submit(time.sleep, 100)\n"
        "    while not busy.running(): time.sleep(0.01)\n"
        "    raise SystemExit(3)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == 3
