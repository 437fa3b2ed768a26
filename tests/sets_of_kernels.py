"""Tests of the renderer's kernels: on both sets, and on all threads."""

from importlib.util import find_spec

import pytest

from gof.host.threads import core_count


def draw_with(name: str, monkeypatch) -> None:
    """Draw with these kernels, or skip where they cannot run."""
    if name == "native":
        pytest.importorskip("numba")
        from gof.render.backend import BACKEND

        if BACKEND == "cuda":
            pytest.skip("native kernels are for CPUs")
    monkeypatch.setenv("GOF_RENDER_KERNELS", name)


@pytest.fixture(scope="module", autouse=True)
def all_threads():
    """As many of Dr.Jit's threads as the renderer takes by itself, and never one alone; tests elsewhere have one."""
    if find_spec("drjit") is None:
        yield
        return
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(max(2, min(core_count(), 8)))
    yield
    dr.set_thread_count(before)
