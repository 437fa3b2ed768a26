"""A step draws and moves the Gaussians that are alight when its picture is taken: the result is that of all of them."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof.reconstruct import optimize
from gof.reconstruct.batches import sort_by_picture
from gof.reconstruct.parameters import GROUP, alight, per_gaussian, splats, to_raw
from gof.render import render_splats
from gof.render.adam import Adam
from gof.render.backend import BACKEND
from tests.conftest import arc
from tests.reconstruct.rising_flame import DT, column, reconstruct, write_flame

pytestmark = pytest.mark.usefixtures("kernels")

VOXEL = 0.1


def short_lived(n=500, lives=0.4) -> TransientGaussians:
    """They shine one after the other over ten frames, in the order in which they lie in memory."""
    flame = column(DT * np.arange(10), n)
    rng = np.random.default_rng(5)
    return replace(
        flame,
        t_mu=np.linspace(0, 9 * DT, n).astype(np.float32),
        t_sigma=rng.uniform(0.5 * lives * DT, 1.5 * lives * DT, n).astype(np.float32),
        scale=np.clip(flame.scale, 0.011, 0.29),
    )


@pytest.mark.parametrize("row_time_s", [0.0, DT / 96])
@pytest.mark.parametrize("time_s", [-1.0, 0.0, 0.07, 9 * DT, 1e4])
def test_whoever_can_be_seen_is_among_the_rows(row_time_s, time_s):
    flame = short_lived()
    camera = replace(arc(1, width=48, height=96, focal_px=110.0)[0], row_time_s=row_time_s)
    rows, _, _ = sort_by_picture(alight(to_raw(flame, VOXEL, 0.0), VOXEL, np.array([time_s]), camera))
    if row_time_s == 0:
        opacity = flame.opacity * np.exp(-0.5 * ((time_s - flame.t_mu) / flame.t_sigma) ** 2)
        assert set(np.flatnonzero(opacity >= 1 / 255)) <= set(rows.tolist())
    assert (np.diff(rows.astype(int)) > 0).all() and rows.dtype == np.uint32 and 0 < len(rows) < 300
    taken = np.bincount(rows // GROUP)
    assert set(taken[taken > 0].tolist()) <= {GROUP, len(flame) % GROUP}, "whole groups"
    frames = [
        render_splats(splats(raw, VOXEL, time_s, camera), camera)
        for raw in (to_raw(flame, VOXEL, 0.0), to_raw(flame[rows], VOXEL, 0.0))
    ]
    for whole, part in zip(frames[0].color, frames[1].color, strict=True):
        np.testing.assert_array_equal(part.numpy(), whole.numpy())


def test_a_set_smaller_than_a_group():
    flame = short_lived(5)
    camera = arc(1, width=48, height=96, focal_px=110.0)[0]
    dark = alight(to_raw(flame, VOXEL, 0.0), VOXEL, np.array([1e4]), camera)
    assert not dark.any() and sort_by_picture(dark)[0].tolist() == [0, 1, 2, 3, 4]


def test_another_number_of_them_compiles_nothing():
    optimizer = Adam(lr=0.01, params=to_raw(short_lived(), VOXEL, 0.0), epsilon=1e-15, mask_updates=True)
    camera, counts, misses = arc(1, width=48, height=96, focal_px=110.0)[0], [], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for k in range(6):
            dr.kernel_history_clear()
            rows, _, _ = sort_by_picture(alight(optimizer, VOXEL, np.array([1.5 * k * DT]), camera))
            seen = splats(optimizer.only(per_gaussian(optimizer), rows), VOXEL, 1.5 * k * DT, camera)
            dr.backward(sum(dr.sum(dr.square(c)) for c in render_splats(seen, camera).color))
            optimizer.step()
            dr.eval(list(optimizer.values()))
            counts.append(len(rows))
            misses.append(sum(not x["cache_hit"] for x in dr.kernel_history() if x["type"] == dr.KernelType.JIT))
    assert len(set(counts)) > 3 and misses[3:] == [0, 0, 0]


@pytest.fixture
def one_thread():
    """Several add up in another order each time, and optimisations grow apart by that."""
    threads = dr.thread_count()
    dr.set_thread_count(1)
    yield
    dr.set_thread_count(threads)


def test_gaussians_of_several_pictures_are_taken_in_order_and_again_where_they_are_in_two():
    alight = np.zeros((3, 50), bool)
    alight[0, [1, 2, 20]], alight[1, [2, 3, 49]], alight[2, [2, 4]] = True, True, True
    rows, again, picture = sort_by_picture(alight)
    np.testing.assert_array_equal(rows, [*range(32), 48, 49])  # groups of 16, the last cut
    np.testing.assert_array_equal(rows[again], [2, 2])
    np.testing.assert_array_equal(picture[len(rows) :], [1, 2])
    first = dict(zip(rows.tolist(), picture.tolist(), strict=False))
    assert [first[row] for row in (1, 2, 20, 3, 49, 4)] == [0, 0, 0, 1, 1, 2]
    assert {array.dtype for array in (rows, again, picture)} == {np.dtype(np.uint32)}


@pytest.mark.skipif(BACKEND == "cuda", reason="a GPU adds gradients in another order each time, and Adam magnifies it")
@pytest.mark.parametrize("scene", ["plates", "gaussians"])
def test_a_reconstruction_is_the_same_as_with_all_in_every_step(scene, kernels, one_thread, tmp_path, monkeypatch):
    folder = write_flame(tmp_path / "flame")
    if scene == "gaussians":
        (folder / "depth").mkdir()
        for c in range(3):
            np.save(folder / "depth" / f"cam_{c}.npy", np.full((96, 48), 5.0, np.float32))
    shares, shown = [], optimize.Flame.shown

    def counted(flame, *view):
        found = shown(flame, *view)
        shares.append(dr.width(found.raw["t_mu"]) / dr.width(flame.optimizer["t_mu"]))
        return found

    small = {"iterations": 40, "gaussians": 1500, "voxels": 24, "scene": scene}
    monkeypatch.setattr(optimize, "count_together", lambda *_: 1)
    monkeypatch.setattr(optimize.Flame, "shown", counted)
    part = TransientGaussians.load(reconstruct(folder, tmp_path / "part", **small))
    monkeypatch.setattr(optimize.Flame, "shown", lambda flame, *_: optimize.BatchGaussians(flame.optimizer, None))
    every = TransientGaussians.load(reconstruct(folder, tmp_path / "every", **small))
    assert np.mean(shares) < 0.9, "otherwise hardly anything was left out"
    for name in ("position", "velocity", "t_mu", "t_sigma", "scale", "rotation", "opacity", "color"):
        # Native sums go through memory in one order; Dr.Jit's scatters meet other Gaussians side by side.
        atol = 0 if kernels == "native" else 1e-4
        np.testing.assert_allclose(getattr(part, name), getattr(every, name), rtol=0, atol=atol, err_msg=name)
