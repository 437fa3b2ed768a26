"""On an NVIDIA GPU pictures, gradients and steps are those of the CPU; how its lists are sorted is tested anywhere."""

import os
import subprocess
import sys

import drjit as dr
import numpy as np
import pytest

from gof.render import bins, blend, render_splats
from gof.render.backend import BACKEND, UInt, whole_numbers
from tests.render.drawing import gradients, image, loss_weights, splats, weighted_sum
from tests.render.scenes import camera, gaussians

on_gpu = pytest.mark.skipif(not dr.has_backend(dr.JitBackend.CUDA), reason="Dr.Jit finds no NVIDIA GPU here")

LEARN = """
import sys
import drjit as dr
import numpy as np
from gof.render import Target, l1_ssim, render_splats
from gof.render.adam import Adam
from gof.render.backend import BACKEND
from tests.render import drawing, scenes

camera, g = scenes.camera(160, 90), scenes.gaussians(3000)
s = drawing.splats(g, grad=True)
frame = render_splats(s, camera, depth=True)
out = {"color": drawing.image(frame.color, camera), "depth": drawing.image([frame.depth], camera)}
dr.backward(drawing.weighted_sum(frame, *drawing.loss_weights(camera, 3)))
out |= {f"d/d {name}": value for name, value in drawing.gradients(s).items()}
raw = {"position": s.position, "opacity": s.opacity}
optimizer = Adam(lr=1e-3, params={k: dr.detach(v) for k, v in raw.items()}, mask_updates=True)
target, rows = Target(np.random.default_rng(1).random((90, 160, 3))), np.arange(100, 1500, dtype=np.uint32)
for _ in range(5):
    p = optimizer.only(raw, rows)
    part = drawing.splats({k: v[100:1500] for k, v in g.items()})
    part.position, part.opacity = p["position"], p["opacity"]
    dr.backward(l1_ssim(render_splats(part, camera).color, target))
    optimizer.step()
out |= {f"moved {k}": np.array(dr.detach(optimizer[k]).numpy()) for k in raw}
np.savez(sys.argv[1], **out)
print(BACKEND)
"""


def learn(backend: str, path) -> dict[str, np.ndarray]:
    """Draw, differentiate and learn in a process of its own, on this backend."""
    environment = os.environ | {"GOF_RENDER_BACKEND": backend, "GOF_RENDER_KERNELS": "drjit"}
    done = subprocess.run([sys.executable, "-c", LEARN, str(path)], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [backend]
    return dict(np.load(path))


@on_gpu
def test_a_gpu_draws_differentiates_and_learns_as_the_cpu_does(tmp_path):
    cpu, gpu = learn("llvm", tmp_path / "cpu.npz"), learn("cuda", tmp_path / "gpu.npz")
    for name, values in cpu.items():
        size = np.abs(values).max()
        np.testing.assert_allclose(gpu[name], values, atol=1e-3 * size, rtol=0, err_msg=name)
        assert np.abs(gpu[name] - values).mean() < 1e-5 * size, name


@pytest.mark.parametrize("count", [1, 2, 300, 16_384, 1_000_000])
@pytest.mark.parametrize("digit_bits", [None, 8])
def test_equal_keys_keep_their_order(count, digit_bits, monkeypatch):
    """More keys than a GPU's counters have room for are sorted digit by digit."""
    if digit_bits:
        monkeypatch.setattr(bins, "DIGIT_BITS", digit_bits)
    keys = np.random.default_rng(count).integers(0, count, 200_000)
    order = bins.stable_order(whole_numbers(keys), count)
    assert type(order) is UInt
    np.testing.assert_array_equal(order.numpy(), np.argsort(keys, kind="stable"))


def test_lists_that_are_sorted_digit_by_digit_draw_the_same(monkeypatch):
    monkeypatch.setenv("GOF_RENDER_KERNELS", "drjit")
    view, g = camera(120, 90), gaussians(2000)
    drawn = []
    for digit_bits in (32, 3):
        monkeypatch.setattr(bins, "DIGIT_BITS", digit_bits)
        s = splats(g, grad=True)
        frame = render_splats(s, view, depth=True, deterministic=True)
        color = image(frame.color, view)
        dr.backward(weighted_sum(frame, *loss_weights(view, 3)))
        drawn.append({"color": color, **gradients(s)})
    for name, values in drawn[0].items():
        np.testing.assert_array_equal(drawn[1][name], values, err_msg=name)


@pytest.mark.parametrize("share", [blend.Share(4, 1), blend.Share(1, 1)], ids=str)
@pytest.mark.parametrize("absgrad", [False, True])
def test_lanes_that_share_a_block_draw_the_same(share, absgrad, monkeypatch):
    """As on a GPU: a lane has one pixel or four, not all sixteen of a block, and fetches ahead."""
    monkeypatch.setenv("GOF_RENDER_KERNELS", "drjit")
    view, g = camera(121, 90), gaussians(2000)  # no whole number of blocks
    drawn = []
    for part in (blend.WHOLE, share):
        monkeypatch.setattr(blend, "SHARE", part)
        s = splats(g, grad=True)
        frame = render_splats(s, view, depth=True, absgrad=absgrad)
        color = image(frame.color, view)
        dr.backward(weighted_sum(frame, *loss_weights(view, 3)))
        drawn.append({"color": color, **gradients(s)})
        if absgrad:
            drawn[-1]["absgrad"] = np.array(frame.mean2d_absgrad.numpy())
    for name, values in drawn[0].items():
        atol = (2e-5 if BACKEND == "llvm" else 1e-3) * np.abs(values).max()  # a GPU rounds each kernel its own way
        np.testing.assert_allclose(drawn[1][name], values, atol=atol, err_msg=name)
