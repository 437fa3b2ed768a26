"""Sharing memory between numpy and Dr.Jit."""

import gc
import time

import numpy as np

from gof.render import backend
from gof.render.backend import Float, floats, shifted


def test_a_shifted_array_reads_the_same_memory_and_keeps_it_alive():
    base = floats(np.arange(1000))
    view = shifted(base, 100, 50)
    np.testing.assert_array_equal(view.numpy(), np.arange(100, 150))
    del base
    for _ in range(20):
        floats(np.full(1000, -1.0))  # would take the memory if it were free
    np.testing.assert_array_equal((view + 0).numpy(), np.arange(100, 150))


def test_the_owner_is_let_go_on_the_calling_thread():
    """Dr.Jit releases shared memory on a thread of its own; a Dr.Jit array must not die there (deadlock)."""
    backend._released.clear()
    view = shifted(floats(np.arange(64)), 0, 64)
    del view
    for _ in range(100):
        gc.collect()
        if backend._released:
            break
        time.sleep(0.02)
    assert len(backend._released) == 1 and isinstance(backend._released[0], Float)
    shifted(floats(np.arange(4)), 0, 2)
    assert len(backend._released) <= 1
