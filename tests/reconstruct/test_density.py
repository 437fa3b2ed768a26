"""Density control: who is cloned, split and pruned is worked out by hand; Adam's moments and resumed runs are kept."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
from scipy.spatial import cKDTree

from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.reconstruct import density, optimize, pipeline
from gof.reconstruct.density import _Seen, changed
from gof.reconstruct.methods import METHODS, PAPER
from gof.reconstruct.parameters import from_raw, per_gaussian, to_raw
from gof.reconstruct.presets import Effort
from gof.reconstruct.settings import ReconstructionSettings
from gof.render.adam import Adam
from tests.reconstruct.rising_flame import write_flame

VOXEL = 0.02


def some(n=6) -> TransientGaussians:
    """Gaussians in a row, a voxel apart."""
    return TransientGaussians(
        position=np.column_stack([np.arange(n) * VOXEL, np.zeros(n), np.zeros(n)]),
        velocity=np.tile([0.0, 0, 1], (n, 1)),
        t_mu=np.linspace(0, 0.1, n),
        t_sigma=np.full(n, 0.05),
        scale=np.full((n, 3), 0.5 * VOXEL),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.4),
        color=np.full((n, 3), 0.5),
        dynamic=np.ones(n, bool),
    )


def seen(*pulls) -> _Seen:
    """Mean pulls in 1e-4, of two pictures each."""
    return _Seen(2e-4 * np.array(pulls, float), np.full(len(pulls), 2.0))


def test_the_constants_are_those_of_3dgs():
    assert (density.FIRST, density.EVERY, density.UNTIL * 30_000) == (500, 100, 15_000)
    assert (density.PULL, density.LARGE, density.SPLIT_SHRINK, density.FAINT) == (2e-4, 0.01, 1.6, 0.005)
    assert (density.WIDE_AFTER, density.WIDE) == (3000, 0.1)
    assert PAPER.density_control and not METHODS["gof"].density_control


def test_small_ones_are_cloned_large_ones_split_faint_ones_pruned():
    old = some()
    old.opacity[4] = 0.004
    old.scale[2] = [0.03, 0.001, 0.001]  # above 0.01 of an extent of 2 m
    kept, born = changed(old, seen(1.9, 2.1, 5, 0, 0, 0), 100, 2.0, False, (0, 600))
    assert kept.tolist() == [0, 1, 3, 5], "the split one and the faint one are gone"
    assert len(born) == 3
    np.testing.assert_allclose(born.position[0], old.position[1])
    np.testing.assert_allclose(born.scale[0], old.scale[1])
    np.testing.assert_allclose(born.scale[1:], np.tile(old.scale[2] / 1.6, (2, 1)), rtol=1e-6)
    assert (born.velocity == [0, 0, 1]).all() and born.t_mu[1] == old.t_mu[2]


def test_halves_are_drawn_from_the_gaussian_that_they_were():
    old = some(4000)
    old.position[:] = 0
    old.scale[:] = [0.03, 0.02, 0.01]
    _, born = changed(old, seen(*[9.0] * 4000), 10**6, 0.1, False, (0, 600))
    assert len(born) == 8000
    np.testing.assert_allclose(born.position.std(0), [0.03, 0.02, 0.01], rtol=0.05)


def test_wide_ones_are_pruned_later_on():
    old = some(3)
    old.scale[1] = 0.21
    for late, expected in ((False, [0, 1, 2]), (True, [0, 2])):
        assert changed(old, seen(0, 0, 0), 9, 2.0, late, (0, 1))[0].tolist() == expected


def test_growth_ends_and_nobody_is_pruned_to_nothing():
    old = some(6)
    _, born = changed(old, seen(3, 9, 4, 5, 6, 7), 8, 2.0, False, (0, 1))
    np.testing.assert_allclose(born.position, old.position[[1, 5]], err_msg="the two that are pulled hardest")
    old.opacity[:] = 0.001
    old.opacity[3] = 0.002
    kept, born = changed(old, seen(*[0] * 6), 9, 2.0, False, (0, 1))
    assert kept.tolist() == [3] and not len(born)


def test_who_stays_keeps_adams_moments_and_rates():
    old = some()
    optimizer = Adam(lr=1.0, params=to_raw(old, VOXEL, 0.0), epsilon=1e-15)
    rates = {name: 0.001 * (k + 1) for k, name in enumerate(optimizer.keys())}
    optimizer.set_learning_rate(rates)
    loss = sum(dr.sum(dr.square(x)) for name in ("x0", "color_logit") for x in optimizer[name]) + dr.sum(
        optimizer["t_mu"]
    )
    dr.backward(loss)
    optimizer.step()
    before = {name: [np.array(x) for x in optimizer.state[name][3][1:3]] for name in optimizer.keys()}
    now = from_raw(optimizer, VOXEL, 0.0)

    control = density.DensityControl(6, 2.0, VOXEL, 0.0, 30_000, 0)
    control._seen = seen(0, 0, 8, 0, 0, 0)
    control.change(599, optimizer)
    after = from_raw(optimizer, VOXEL, 0.0)
    assert len(after) == 7
    for row in range(7):
        match = np.flatnonzero(np.isclose(now.t_mu, after.t_mu[row], atol=1e-6))
        (k,) = match
        np.testing.assert_allclose(after.position[row], now.position[k], atol=1e-6)
        np.testing.assert_allclose(after.scale[row], now.scale[k], rtol=1e-4)
        moments = {name: [np.array(x)[..., row] for x in optimizer.state[name][3][1:3]] for name in optimizer.keys()}
        pairs = [(m, b[..., k]) for name in moments for m, b in zip(moments[name], before[name], strict=True)]
        old_ones = all(np.allclose(m, b) for m, b in pairs)
        none = all((np.asarray(m) == 0).all() for m, _ in pairs)
        assert old_ones or (k == 2 and none)
    assert {name: optimizer.state[name][2] for name in optimizer.keys()} == rates
    dr.backward(dr.sum(optimizer["opacity"]))
    optimizer.step()  # still an optimiser


def test_pruning_alone_and_no_change_at_all():
    old = some()
    old.opacity[1] = 0.001
    optimizer = Adam(lr=1.0, params=to_raw(old, VOXEL, 0.0), epsilon=1e-15)
    control = density.DensityControl(6, 2.0, VOXEL, 0.0, 30_000, 0)
    control._seen = seen(*[0] * 6)
    control.change(599, optimizer)
    assert len(from_raw(optimizer, VOXEL, 0.0)) == 5
    same = [np.array(dr.detach(optimizer[name])) for name in per_gaussian(optimizer)]
    control._seen = seen(*[0] * 5)
    control.change(699, optimizer)
    for name, before in zip(per_gaussian(optimizer), same, strict=True):
        np.testing.assert_array_equal(np.array(dr.detach(optimizer[name])), before)
    control._seen = seen(*[9] * 5)
    control.change(650, optimizer)  # not the time
    assert len(from_raw(optimizer, VOXEL, 0.0)) == 5


@pytest.fixture
def quick(monkeypatch):
    """Density control every 20 steps from the 20th on, and a checkpoint every 40."""
    monkeypatch.setattr(density, "FIRST", 20)
    monkeypatch.setattr(density, "EVERY", 20)
    monkeypatch.setattr(density, "PULL", 1e-6)
    monkeypatch.setattr(optimize, "CHECKPOINT_EVERY", 40)
    monkeypatch.setattr(optimize, "EVALUATE_AT", ())


def run(folder, out) -> TransientGaussians:
    dataset = Dataset.open(folder)
    settings = ReconstructionSettings.of(dataset, Effort(120, 400, 24, 96), method="paper", scene="plates")
    return TransientGaussians.load(pipeline.reconstruct(dataset, settings, out).path)


@pytest.mark.long
def test_the_papers_method_grows_and_goes_on_where_it_was(tmp_path, quick, monkeypatch):
    folder = write_flame(tmp_path / "data")
    whole = run(folder, tmp_path / "whole")
    assert 400 < len(whole) <= density.MOST_GROWTH * 400

    class Stopped(Exception):
        pass

    saved = optimize.save_checkpoint

    def stop(path, optimizer, step, spent):
        saved(path, optimizer, step, spent)
        if step == 40:
            raise Stopped

    monkeypatch.setattr(optimize, "save_checkpoint", stop)
    with pytest.raises(Stopped):
        run(folder, tmp_path / "resumed")
    monkeypatch.setattr(optimize, "save_checkpoint", saved)
    resumed = run(folder, tmp_path / "resumed")
    # Gradients are summed in another order every time, and growth multiplies it: 1e-3 of the flame's metre, and now and
    # then somebody else is cloned, behind whom all stand in other rows.
    assert len(resumed) == pytest.approx(len(whole), rel=0.01)
    assert np.quantile(cKDTree(whole.position).query(resumed.position)[0], 0.95) < 1e-3
    with monkeypatch.context() as without:
        without.setitem(METHODS, "paper", replace(PAPER, density_control=False))
        assert len(run(folder, tmp_path / "without")) <= 400
