"""Sharing memory between numpy and Dr.Jit; which kernels run, how they are compiled, and where they are kept."""

import gc
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.render import backend
from gof.render.backend import Float, floats, shifted

of_cpu = pytest.mark.skipif(backend.BACKEND == "cuda", reason="of the CPU's memory and kernels")


def test_a_shifted_array_reads_the_same_memory_and_keeps_it_alive():
    base = floats(np.arange(1000))
    view = shifted(base, 100, 50)
    np.testing.assert_array_equal(view.numpy(), np.arange(100, 150))
    del base
    for _ in range(20):
        floats(np.full(1000, -1.0))  # would take the memory if it were free
    np.testing.assert_array_equal((view + 0).numpy(), np.arange(100, 150))


@of_cpu
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


def test_the_variable_forces_kernels(monkeypatch):
    monkeypatch.setenv("GOF_RENDER_KERNELS", "drjit")
    assert backend.kernels().name == "drjit" and "GOF_RENDER_KERNELS" in backend.kernels().why
    monkeypatch.setenv("GOF_RENDER_KERNELS", "fortran")
    with pytest.raises(GofError, match="GOF_RENDER_KERNELS is 'fortran'; use 'native' or 'drjit'"):
        backend.kernels()


def test_where_native_kernels_cannot_run_it_is_said_and_the_others_draw(monkeypatch):
    monkeypatch.setattr(backend, "_obstacle_to_native", lambda: "the moon is full")
    monkeypatch.delenv("GOF_RENDER_KERNELS", raising=False)
    assert backend.kernels() == backend.Kernels("drjit", "the moon is full")
    monkeypatch.setenv("GOF_RENDER_KERNELS", "native")
    with pytest.raises(GofError, match="GOF_RENDER_KERNELS=native, but the moon is full"):
        backend.kernels()


@of_cpu
def test_what_stands_in_the_way_of_native_kernels(monkeypatch):
    numba = pytest.importorskip("numba")
    find = backend._obstacle_to_native.__wrapped__
    assert find() is None
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert find() == "NUMBA_DISABLE_JIT is set"
    monkeypatch.setitem(sys.modules, "numba", None)
    assert 'pip install "gaussians-on-fire[fast]"' in find()
    monkeypatch.setattr(backend, "BACKEND", "cuda")
    assert "GOF_RENDER_BACKEND" in find()


STEP = """
import drjit as dr
from gof.render.adam import Adam
from gof.render.backend import Float
optimizer = Adam(lr=0.25, params={"x": Float([1.0] * 300)})
dr.backward(dr.sum(dr.square(optimizer["x"])))
optimizer.step()
print(optimizer["x"][0])
"""  # Adam's is the kernel that is compiled soonest


def step(**variables) -> tuple[float, str]:
    """(loss, what was said) in a process of its own."""
    environment = os.environ | {"GOF_RENDER_KERNELS": "native"} | variables
    done = subprocess.run([sys.executable, "-c", STEP], capture_output=True, text=True, env=environment)
    return float(done.stdout), done.stderr


@of_cpu
@pytest.mark.long
def test_compiling_is_announced_once_and_kept(tmp_path):
    pytest.importorskip("numba")
    first, said = step(XDG_CACHE_HOME=str(tmp_path))
    assert said.count("gof: compiling") == 1 and str(tmp_path / "gof" / "kernels-") in said
    assert list(tmp_path.glob("gof/kernels-*/**/*.nbc"))
    assert step(XDG_CACHE_HOME=str(tmp_path)) == (first, "")


@of_cpu
@pytest.mark.long
def test_without_a_folder_to_keep_them_kernels_are_compiled_each_time(tmp_path):
    pytest.importorskip("numba")
    (tmp_path / "file").touch()
    value, said = step(XDG_CACHE_HOME=str(tmp_path / "file"))
    assert value == pytest.approx(0.75, abs=1e-5) and "no cache folder can be written" in said
    assert [p.name for p in Path(tmp_path).iterdir()] == ["file"], "so the next process has to compile them too"


@pytest.mark.parametrize("asked, expected", [("1", 1), ("1,4", 1), ("100000", None)])
def test_dr_jit_takes_as_many_threads_as_asked_and_never_more(asked, expected):
    program = "import drjit as dr; n = dr.thread_count(); import gof.render.backend; print(n, dr.thread_count())"
    environment = os.environ | {"OMP_NUM_THREADS": asked}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    before, after = map(int, done.stdout.split())
    assert after == (expected or before)


@of_cpu
@pytest.mark.parametrize("asked, expected", [("", "8 4 7 8"), ("12", "12 12 12 12"), ("2", "2 2 2 2")])
def test_many_cores_are_left_idle_where_a_picture_is_too_small_for_them(asked, expected):
    """With 16 threads a step on small pictures takes four times as long as with 4."""
    program = """if True:
        import drjit as dr
        dr.set_thread_count(16)
        from gof.render.backend import threads_for
        counts = [dr.thread_count()]
        for pixels in (144 * 256, 7 * 30_000):
            with threads_for(pixels):
                counts.append(dr.thread_count())
        print(*counts, dr.thread_count())
    """
    environment = os.environ | {"OMP_NUM_THREADS": asked}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    assert done.stdout.strip() == expected, done.stderr


MORE_THREADS = """
import drjit as dr
import numpy as np
from gof.render import Splats, Target, l1_ssim, render_splats
from gof.render.adam import Adam
from gof.render.backend import Array3f, Array4f, floats
from gof.render.scene import columns
from tests.render import scenes

camera, g = scenes.camera(160, 90), scenes.gaussians(5000)
kinds = {"position": Array3f, "rotation": Array4f, "scale": Array3f, "color": Array3f}
raw = {name: columns(g[name], kind) for name, kind in kinds.items()} | {"opacity": floats(g["opacity"])}
optimizer, target = Adam(lr=1e-4, params=raw), Target(np.random.default_rng(1).random((90, 160, 3)))

def step():
    p = optimizer
    splats = Splats(p["position"], p["rotation"], dr.abs(p["scale"]), p["opacity"], list(p["color"]))
    frame = render_splats(splats, camera)
    dr.backward(l1_ssim(frame.color, target))
    optimizer.step()
    dr.sync_thread()
    return frame

most = dr.thread_count()
dr.set_thread_count(1)
for _ in range(3):
    step()
dr.set_thread_count(most)
for _ in range(20):
    frame = step()
print(most, float(dr.sum(frame.color[0])[0]) > 0)
"""


@of_cpu
def test_threads_may_become_more_between_steps():
    """What Dr.Jit records has room for the sums of so many threads; replayed with more, it once wrote beyond it."""
    environment = os.environ | {"GOF_RENDER_KERNELS": "drjit", "OMP_NUM_THREADS": ""}
    done = subprocess.run([sys.executable, "-c", MORE_THREADS], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[1] == "True"
