"""DVE against the paper's formulas written out plainly, closed forms, and every hard case."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError, NonFiniteError
from gof.core.fields import VelocityField, VelocitySequence
from gof.evaluate import dve, dve_sequence
from gof.evaluate.dve_frame import CULL_SHARE, Samples, Sums, _sum, probe, weighted_sums
from gof.evaluate.sequence import sanity_warnings
from tests.evaluate.analytic import Analytic, Sequence, covariance, make_gaussians, waves


def plain_dve(weight, v, truth):
    """The paper's two formulas, one Gaussian at a time."""
    error = power = cosine = total = 0.0
    for w, a, b in zip(weight, v, truth, strict=True):
        error += w * float((a - b) @ (a - b))
        power += w * float(b @ b)
        cosine += w * float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))
        total += w
    return np.sqrt(error / power), cosine / total


@pytest.mark.parametrize("flow", ["abc", "taylor_green"])
def test_against_the_formulas_with_the_analytic_expectation(flow):
    V, mean = waves(2.5)[flow]
    g = make_gaussians(300)
    truth = mean(g.position.astype(float), covariance(g.scale, g.rotation))
    l2, cos = plain_dve(g.scale.astype(float).prod(1) * g.opacity, g.velocity.astype(float), truth)
    got = dve(g, Analytic(V), 0.0, order=7)
    assert got.l2 == pytest.approx(l2, rel=1e-7) and got.cos_sim == pytest.approx(cos, rel=1e-7, abs=1e-9)
    assert got.n == 300 and got.n_culled == 0 and got.undefined == ""
    assert got.speed_ratio == pytest.approx(
        (g.scale.prod(1) * g.opacity * (g.velocity * truth).sum(1)).sum()
        / (g.scale.prod(1) * g.opacity * (truth**2).sum(1)).sum(),
        rel=1e-5,
    )
    assert sum(e**2 for e in got.l2_axis) == pytest.approx(got.l2**2)


def test_perfect_and_half_speed_and_reversed():
    A = np.array([[0, -1, 0], [1, 0, 0], [0.5, 0, 2.0]])
    g = make_gaussians(40)
    exact = g.position.astype(float) @ A.T + 3
    field = Analytic(lambda p: p @ A.T + 3)
    for factor, l2, cos in ((1, 0, 1), (0.5, 0.5, 1), (-1, 2, -1), (0, 1, 0)):
        got = dve(make_gaussians(40, velocity=factor * exact), field, 0.0)
        assert got.l2 == pytest.approx(l2, abs=1e-6) and got.cos_sim == pytest.approx(cos, abs=1e-9)
        assert got.speed_ratio == pytest.approx(factor, abs=1e-6)


def test_gaussians_are_scored_where_they_are_at_that_time():
    """A constant-velocity particle in V = (z, 0, 0): at time t it sits 0.5 t higher and sees that much more."""
    g = make_gaussians(1, position=[[0, 0, 1.0]], velocity=[[1.0, 0, 0.5]], t_mu=[2.0], t_sigma=[3.0])
    field = Analytic(lambda p: p[:, [2]] * np.array([1.0, 0, 0]))
    for t in (2.0, 4.0):
        truth = np.array([1 + 0.5 * (t - 2), 0, 0])
        assert dve(g, field, t).l2 == pytest.approx(np.linalg.norm([1, 0, 0.5] - truth) / truth[0], rel=1e-6)


def test_the_gas_is_scored_where_the_light_has_moved_to():
    """In V = (z, 0, 0) the light rises at 0.5 m/s and says of the gas exactly what is there 2 s later."""
    g = make_gaussians(1, position=[[0, 0, 1.0]], velocity=[[0, 0, 0.5]], t_mu=[2.0], t_sigma=[3.0])
    field = Analytic(lambda p: p[:, [2]] * np.array([1.0, 0, 0]))
    assert dve(replace(g, gas_velocity=[[2.0, 0, 0]]), field, 4.0).l2 == pytest.approx(0, abs=1e-6)
    assert dve(g, field, 4.0).l2 == pytest.approx(np.hypot(2, 0.5) / 2, rel=1e-6)


def test_temporal_and_base_opacity():
    """Two Gaussians, one of them long dead at t = 0: it counts with base opacity only."""
    g = make_gaussians(
        2,
        position=np.zeros((2, 3)),
        velocity=[[1.0, 0, 0], [0, 0, 0]],
        t_mu=[0, 10.0],
        t_sigma=[1.0, 1.0],
        scale=np.full((2, 3), 0.1),
        opacity=[0.5, 0.5],
    )
    field = Analytic(lambda p: np.ones((len(p), 1)) * np.array([1.0, 0, 0]))
    assert dve(g, field, 0.0).l2 == pytest.approx(0, abs=1e-6)
    base = dve(g, field, 0.0, opacity="base")
    assert base.l2 == pytest.approx(np.sqrt(0.5)) and base.cos_sim == pytest.approx(0.5) and base.n == 2
    with pytest.raises(GofError, match="opacity"):
        dve(g, field, 0.0, opacity="peak")


def test_static_gaussians_are_left_out_unless_asked_for():
    g = make_gaussians(
        2,
        position=np.zeros((2, 3)),
        velocity=[[1.0, 0, 0], [1.0, 0, 0]],
        dynamic=[True, False],
        scale=np.full((2, 3), 0.1),
        opacity=[0.5, 0.5],
    )
    field = Analytic(lambda p: np.ones((len(p), 1)) * np.array([1.0, 0, 0]))
    assert dve(g, field, 0.0).n == 1 and dve(g, field, 0.0).l2 == pytest.approx(0, abs=1e-7)
    both = dve(
        g, field, 0.0, include_static=True
    )  # a static Gaussian's stored velocity means nothing: it counts as zero
    assert both.n == 2 and both.l2 == pytest.approx(np.sqrt(0.5))
    assert both.weight_zero_velocity == pytest.approx(0.5)


# --- hard cases -----------------------------------------------------------------------------------------------------


def test_all_zero_true_field_is_undefined_and_says_why():
    got = dve(make_gaussians(), Analytic(np.zeros_like), 0.0)
    assert got.l2 is None and got.speed_ratio is None and "zero" in got.undefined
    assert got.cos_sim == 0 and got.weight_zero_truth == pytest.approx(1)


@pytest.mark.parametrize("case", ["no gaussians", "zero opacity", "dead", "all static"])
def test_nothing_to_weigh(case):
    g = {
        "no gaussians": make_gaussians(0),
        "zero opacity": make_gaussians(3, opacity=np.zeros(3)),
        "dead": make_gaussians(3, t_mu=np.full(3, 1e6), t_sigma=np.ones(3)),
        "all static": make_gaussians(3, dynamic=np.zeros(3, bool)),
    }[case]
    got = dve(g, Analytic(np.ones_like), 0.0)
    assert (got.l2, got.cos_sim, got.n, got.weight, got.weight_outside) == (None, None, 0, 0, 0)
    assert "weight" in got.undefined
    with pytest.raises(GofError):
        dve_sequence(g, Sequence([0.0], lambda t: Analytic(np.ones_like)))


@pytest.mark.parametrize("speed", [1e-12, 1.0, 1e6])
def test_scores_do_not_depend_on_the_unit_of_speed(speed):
    V, _ = waves(2.0)["abc"]
    g = make_gaussians(30)
    one = dve(g, Analytic(V), 0.0)
    got = dve(make_gaussians(30, velocity=g.velocity * speed), Analytic(lambda p: speed * V(p)), 0.0)
    assert got.l2 == pytest.approx(one.l2, rel=1e-6) and got.cos_sim == pytest.approx(one.cos_sim, rel=1e-6)
    assert got.weight_zero_truth == got.weight_zero_velocity == 0


def test_half_outside_counts_as_zero_truth_and_is_reported():
    g = make_gaussians(1, position=[[1.0, 0, 0]], velocity=[[2.0, 0, 0]], rotation=[[1.0, 0, 0, 0]])
    field = Analytic(lambda p: np.array([2.0, 0, 0]) + 0 * p, -1.0, 1.0 - 1e-6)
    samples = probe(g, field, 0.0)
    assert samples.inside[0] == pytest.approx(1 / 6)
    got = dve(g, field, 0.0)
    assert got.weight_outside == pytest.approx(5 / 6)
    assert got.l2 == pytest.approx(5.0)  # expected velocity 2/6: error 10/6 over 2/6
    far = make_gaussians(
        2,
        position=[[0, 0, 0], [9.0, 0, 0]],
        velocity=[[2.0, 0, 0]] * 2,
        scale=np.full((2, 3), 0.05),
        opacity=[0.5, 0.5],
    )
    score = dve_sequence(far, Sequence([0.0], lambda t: field))
    assert score.pooled.weight_outside == pytest.approx(0.5)
    assert (score.l2, score.cos_sim) == (pytest.approx(1), pytest.approx(0.5))
    assert (score.inside.l2, score.inside.cos_sim, score.inside.n) == (pytest.approx(0, abs=1e-6), pytest.approx(1), 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_cell_is_an_error_only_where_it_is_read(bad):
    velocity = np.ones((8, 8, 8, 3), np.float32)
    velocity[7, 7, 7, 1] = bad
    field = VelocityField.from_array(velocity, (-4, -4, -4), 1.0)
    assert dve(make_gaussians(5), field, 0.0).l2 is not None
    with pytest.raises(NonFiniteError, match=r"near \[3\.4"):
        dve(make_gaussians(1, position=[[3.4, 3.4, 3.4]]), field, 0.0)


def test_culling_stays_within_its_bound():
    rng = np.random.default_rng(4)
    n = 3000
    g = make_gaussians(
        n, opacity=10.0 ** rng.uniform(-20, 0, n), velocity=rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-3, 3, (n, 1))
    )
    V, _ = waves(2.0)["abc"]
    samples = probe(g, Analytic(V), 0.0)
    assert samples.culled > 300 and samples.culled + len(samples.index) == n
    w = g.scale.astype(float).prod(1) * g.opacity
    speed2 = (g.velocity.astype(float) ** 2).sum(1)
    out = np.setdiff1d(np.arange(n), samples.index)
    assert w[out].sum() <= CULL_SHARE * w.sum() and (w * speed2)[out].sum() <= CULL_SHARE * (w * speed2).sum()
    truth = V(g.position.astype(float))  # scored without culling, against the field at the centres, as with order 1
    l2, cos = plain_dve(w, g.velocity.astype(float), truth)
    got = dve(g, Analytic(V), 0.0, order=1)
    assert got.l2 == pytest.approx(l2, rel=3e-9) and got.cos_sim == pytest.approx(cos, abs=3e-9)


def test_a_faint_but_enormously_fast_gaussian_is_not_culled():
    g = make_gaussians(2, opacity=[1.0, 1e-12], velocity=[[1.0, 0, 0], [1e9, 0, 0]], scale=np.full((2, 3), 0.1))
    assert dve(g, Analytic(np.ones_like), 0.0).n == 2


def test_order_of_the_gaussians_does_not_matter():
    rng = np.random.default_rng(5)
    n = 200_000
    sure = np.full(n, np.inf)
    weight, v, t = 10.0 ** rng.uniform(-6, 0, n), rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    inside, wide = np.ones(n), np.zeros(n, bool)
    a, b = (
        weighted_sums(Samples(0.0, np.arange(n), v[i], weight[i], v[i], sure, t[i], t[i], inside, wide, 0))
        for i in (np.arange(n), rng.permutation(n))
    )
    for name in ("weight", "error2", "truth2", "cosine"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-12)


@pytest.mark.long
def test_sums_of_ten_million_terms_are_right_in_any_order():
    rng = np.random.default_rng(6)
    terms = 10.0 ** rng.uniform(-8, 0, 10_000_000)
    exact = math.fsum(terms)
    for values in (terms, terms[::-1].copy(), np.sort(terms), rng.permutation(terms)):
        assert _sum(values) == pytest.approx(exact, rel=1e-14)


def test_float32_grid_and_float64_field_agree():
    V, _ = waves(2.0)["abc"]
    n, h = 96, 2.4 / 96
    grid = VelocityField.from_array(np.zeros((n, n, n, 3)), (-1.2, -1.2, -1.2), h)
    exact = grid.cell_centers()
    f64 = VelocityField.from_array(V(exact.reshape(-1, 3)).reshape(n, n, n, 3), (-1.2, -1.2, -1.2), h)
    f32 = VelocityField.from_array(f64.velocity.astype(np.float32), (-1.2, -1.2, -1.2), h)
    g = make_gaussians(200)
    a, b, c = dve(g, f64, 0.0), dve(g, f32, 0.0), dve(g, Analytic(V), 0.0)
    assert abs(a.l2 - b.l2) < 1e-6 and abs(a.cos_sim - b.cos_sim) < 1e-6
    assert abs(a.l2 - c.l2) < 1e-3 and abs(a.cos_sim - c.cos_sim) < 1e-3  # tri-linear blur of the grid


def test_wide_gaussians_are_reported():
    g = make_gaussians(2, scale=[[0.1, 0.1, 0.1], [0.1, 0.1, 0.8]], opacity=[0.8, 0.1])
    assert dve(g, Analytic(np.ones_like, voxel_size=0.3), 0.0).weight_undersampled == pytest.approx(0.5)


# --- sequences ------------------------------------------------------------------------------------------------------


def moving_case(times=(0.0, 0.5, 1.0)):
    V, _ = waves(2.0)["abc"]
    g = make_gaussians(60, t_mu=np.linspace(0, 1, 60), t_sigma=np.full(60, 0.3))
    return g, Sequence(times, lambda t: Analytic(lambda p: V(p) * (1 + t)))


def test_pooled_and_frame_scores():
    g, sequence = moving_case()
    score = dve_sequence(g, sequence)
    single = [dve(g, sequence.at(t), t) for t in sequence.times_s]
    assert [f.l2 for f in score.frames] == [s.l2 for s in single]
    parts = [weighted_sums(probe(g, sequence.at(t), t)) for t in sequence.times_s]
    pooled = np.sqrt(sum(p.error2 for p in parts) / sum(p.truth2 for p in parts))
    assert score.l2 == pytest.approx(pooled) and score.l2 != pytest.approx(np.mean([s.l2 for s in single]))
    values = [s.l2 for s in single]
    assert score.spread("l2") == (pytest.approx(np.mean(values)), pytest.approx(np.std(values)), 3)
    lean = dve_sequence(g, sequence, trivial_baselines=False)
    assert lean.pooled == score.pooled and lean.frames == score.frames and not lean.trivial_baselines


def test_undefined_frames_are_skipped_in_the_mean_and_counted():
    g, _ = moving_case()
    sequence = Sequence([0.0, 0.5, 40.0], lambda t: Analytic(np.zeros_like if t == 0 else np.ones_like))
    score = dve_sequence(g, sequence)
    assert [bool(f.undefined) for f in score.frames] == [True, False, True] and score.spread("l2")[2] == 1
    assert score.frames[0].l2 is None and "zero" in score.frames[0].undefined
    assert "weight" in score.frames[2].undefined


def test_missing_frames_and_foreign_clocks(tmp_path):
    fields = [
        VelocityField.from_array(np.full((4, 4, 4, 3), 1 + t, np.float32), (-1, -1, -1), 0.5, t)
        for t in (0.0, 0.1, 0.4)
    ]
    store = VelocitySequence.create(tmp_path / "v.zarr", fields)
    g = make_gaussians(10, t_mu=np.full(10, 0.2), t_sigma=np.full(10, 0.2))
    assert len(dve_sequence(g, store).frames) == 3  # frames 2 and 3 of the clip are missing: score what there is
    with pytest.raises(DataFormatError, match="outside the stored clock"):
        dve_sequence(g, store, times_s=[0.0, 0.5])
    milliseconds = make_gaussians(10, t_mu=np.full(10, 200.0), t_sigma=np.full(10, 20.0))
    with pytest.raises(GofError, match="clocks do not overlap"):
        dve_sequence(milliseconds, store)
    with pytest.raises(GofError, match="empty"):
        dve_sequence(g, store, times_s=[])


def test_units_are_questioned():
    g, sequence = moving_case()
    assert sanity_warnings(dve_sequence(g, sequence, trivial_baselines=False)) == []
    fast = make_gaussians(60, velocity=1000 * waves(2.0)["abc"][0](g.position.astype(float)))
    hints = sanity_warnings(dve_sequence(fast, Sequence([0.0], sequence.at), trivial_baselines=False))
    assert "times the true ones" in hints[0]
    box = Sequence([0.0], lambda t: Analytic(np.ones_like, -0.01, 0.01))
    assert "centimetres" in sanity_warnings(dve_sequence(make_gaussians(60), box, trivial_baselines=False))[0]


@pytest.mark.parametrize("factor,word", [(100, "cm/s"), (1e-3, "millisecond")])
def test_velocities_in_centimetres_or_per_millisecond_are_questioned(factor, word):
    g, sequence = moving_case()
    V = waves(2.0)["abc"][0]
    right = make_gaussians(60, velocity=V(g.position.astype(float)))
    assert sanity_warnings(dve_sequence(right, Sequence([0.0], sequence.at), trivial_baselines=False)) == []
    wrong = make_gaussians(60, velocity=factor * right.velocity)
    assert word in sanity_warnings(dve_sequence(wrong, Sequence([0.0], sequence.at), trivial_baselines=False))[0]


def test_sums_add_up():
    g, sequence = moving_case()
    a, b = (weighted_sums(probe(g, sequence.at(t), t)) for t in (0.0, 0.5))
    total = a + b + Sums()
    assert total.n == a.n + b.n and total.weight == a.weight + b.weight
    np.testing.assert_allclose(total.error2_axis, np.add(a.error2_axis, b.error2_axis))


@pytest.mark.parametrize("wrong", [0.5, 2.0])
def test_uncertainty_is_scored_by_what_lies_within_it(wrong):
    """Half of the weight is off by 1 m/s along x and says so, half by more along x and z; one says nothing."""
    field = VelocityField.from_array(np.zeros((8, 8, 8, 3)), (-4, -4, -4), 1.0)
    velocity = np.array([[1.0, 0, 0], [wrong, 0, wrong], [9.0, 9, 9]])
    says = np.array([1.0, 1.0, np.inf])
    gaussians = make_gaussians(
        3,
        position=np.zeros((3, 3)),
        velocity=velocity,
        velocity_sd=says,
        scale=np.full((3, 3), 0.1),
        opacity=np.full(3, 0.5),
    )
    expected = (1 + 1) / 2 if wrong <= 1 else (1 + 1 / 3) / 2
    still = Sequence([0.0], lambda time_s: field)
    assert dve_sequence(gaussians, still).within_sd == pytest.approx(expected)
    gaussians.velocity_sd[:] = np.inf
    assert dve_sequence(gaussians, still).within_sd is None
