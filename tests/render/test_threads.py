"""A kernel's parts on several threads: each is done once, errors come back, and the caller stays as it was."""

import threading
import weakref

import numpy as np
import pytest

pytest.importorskip("drjit")

from gof.render.native import threads


@pytest.fixture(params=["Dr.Jit's threads", "Python's"], autouse=True)
def pool(request, monkeypatch):
    if request.param == "Python's":
        monkeypatch.setattr(threads, "LIBRARY", "no such library")
    threads._drjit_pool.cache_clear()
    assert (threads._drjit_pool() is None) == (request.param == "Python's")
    yield request.param
    threads._drjit_pool.cache_clear()


def test_every_part_is_done_once():
    done = np.zeros(1000, int)

    def work(begin, end):
        done[begin:end] += 1

    threads.run(work, threads.even_parts(1000, 37))
    assert (done == 1).all()
    threads.run(work, [])
    threads.run(work, [(0, 1000)])
    assert (done == 2).all()


def test_parts_are_done_side_by_side():
    who, both = set(), threading.Barrier(2)

    def wait(_):
        who.add(threading.get_ident())
        both.wait(timeout=60)  # one after the other, the first would wait in vain

    threads.run(wait, [(k,) for k in range(2)])
    assert len(who) == 2


@pytest.mark.parametrize("error", [ValueError("part 3"), KeyboardInterrupt()])
def test_what_a_part_raises_is_raised_and_the_others_are_done(error):
    done = []

    def work(k):
        if k == 3:
            raise error
        done.append(k)

    with pytest.raises(type(error)):
        threads.run(work, [(k,) for k in range(8)])
    assert sorted(done) == [0, 1, 2, 4, 5, 6, 7]


def test_no_thread_keeps_what_it_worked_on():
    class Array:
        pass

    held = Array()
    gone = weakref.ref(held)
    threads.run(lambda k, held=held: held, [(k,) for k in range(8)])
    del held
    assert gone() is None


def test_the_callers_smallest_numbers_stay():
    """Dr.Jit's threads take numbers below 1e-38 for 0, and so does who works among them; not for longer."""
    threads.run(lambda k: None, [(k,) for k in range(8)])
    tiny = np.array([1e-40, 1e-42], np.float32)
    assert (tiny * np.float32(1.0) > 0).all()


def test_two_callers_at_a_time():
    sums = np.zeros((2, 64))

    def caller(row):
        for _ in range(50):
            threads.run(lambda k: sums[row].__setitem__(k, sums[row, k] + 1), [(k,) for k in range(64)])

    callers = [threading.Thread(target=caller, args=(row,)) for row in range(2)]
    for one in callers:
        one.start()
    for one in callers:
        one.join(60)
    assert (sums == 50).all()
