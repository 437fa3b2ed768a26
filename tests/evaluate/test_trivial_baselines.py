"""Trivial baselines and the fluctuation score on flows where their values are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.evaluate import dve_sequence
from gof.evaluate.dve_frame import probe, weighted_sums
from gof.evaluate.intervals import own_generator
from gof.evaluate.trivial_baselines import TRIVIAL_BASELINES, skill
from tests.evaluate.analytic import Analytic, Sequence, make_gaussians


def plume(p):
    """Rising faster with height, plus a swirl that has no mean at any height."""
    return np.stack([-p[:, 1], p[:, 0], 2 + 1.5 * p[:, 2]], 1)


@pytest.fixture(scope="module")
def case():
    noise = 0.3 * np.random.default_rng(8).normal(size=(4000, 3))
    g = make_gaussians(4000, seed=7)
    g = make_gaussians(4000, seed=7, velocity=plume(g.position.astype(float)) + noise)
    sequence = Sequence([0.0, 1e-3], lambda t: Analytic(plume))
    return g, sequence, dve_sequence(g, sequence)


def test_all_trivial_baselines_with_known_values(case):
    g, sequence, score = case
    assert set(score.trivial_baselines) == set(TRIVIAL_BASELINES) - {"light"}, "gas and light move as one here"
    c = score.trivial_baselines
    assert c["zero"].l2 == 1 and c["zero"].cos_sim == 0 and c["zero"].pooled.weight_zero_velocity == pytest.approx(1)
    assert c["true_centre"].l2 == pytest.approx(0, abs=1e-6)  # the field is linear: its mean is its centre value
    assert c["true_centre"].cos_sim == pytest.approx(1)
    assert abs(c["random"].cos_sim) < 0.1 and c["random"].l2 > 1
    assert c["random"].pooled.weight == pytest.approx(score.pooled.weight)
    # the best single vector has L2^2 = 1 - |mean|^2 / mean square
    parts = [probe(g, sequence.at(t), t) for t in sequence.times_s]
    w = np.concatenate([p.weight for p in parts])
    truth = np.concatenate([p.truth for p in parts])
    mean = (w[:, None] * truth).sum(0) / w.sum()
    assert c["constant"].l2 == pytest.approx(np.sqrt(1 - w.sum() * (mean @ mean) / (w * (truth**2).sum(1)).sum()))
    assert c["constant"].l2 > c["height_mean"].l2 > 0.05  # the swirl is left
    assert c["shuffled"].cos_sim < score.cos_sim


def test_light_is_the_score_of_how_the_gaussians_move(case):
    g, sequence, score = case
    double = dve_sequence(replace(g, gas_velocity=2 * g.velocity), sequence)
    assert double.trivial_baselines["light"].l2 == pytest.approx(score.l2)
    assert double.trivial_baselines["light"].cos_sim == pytest.approx(score.cos_sim)
    assert double.l2 > score.l2 and double.trivial_baselines["zero"].l2 == 1


def test_no_constant_vector_beats_the_constant_trivial_baseline(case):
    g, sequence, score = case
    rng = np.random.default_rng(0)
    parts = [probe(g, sequence.at(t), t) for t in sequence.times_s]
    for _ in range(20):
        vector = rng.normal(size=3) * 0.2 + [0, 0, 2]
        sums = sum(
            (weighted_sums(p, np.broadcast_to(vector, p.truth.shape)) for p in parts[1:]),
            weighted_sums(parts[0], np.broadcast_to(vector, parts[0].truth.shape)),
        )
        assert np.sqrt(sums.error2 / sums.truth2) >= score.trivial_baselines["constant"].l2


def test_trivial_baselines_move_no_gaussian(case):
    """Only the scored velocity is replaced: weights, and so shares, are those of the result."""
    _, _, score = case
    for trivial_baseline in score.trivial_baselines.values():
        assert trivial_baseline.pooled.weight == score.pooled.weight and trivial_baseline.pooled.n == score.pooled.n


def test_seed_makes_trivial_baselines_repeat(case):
    g, sequence, score = case
    again, other = dve_sequence(g, sequence), dve_sequence(g, sequence, seed=1)
    assert again.trivial_baselines["random"].l2 == score.trivial_baselines["random"].l2
    assert other.trivial_baselines["random"].l2 != score.trivial_baselines["random"].l2


def test_fluctuation_of_means_is_one_and_zero(case):
    """A result that only knows the mean per height, however right, has no fluctuation at all."""
    g, sequence, score = case
    rise = make_gaussians(4000, seed=7, velocity=np.array([0, 0, 2.0]) + 0 * g.velocity)
    f = dve_sequence(rise, sequence).fluctuation
    assert f.l2 == pytest.approx(1, abs=1e-9) and f.cos_sim == 0
    assert f.weight_zero_velocity == pytest.approx(1)
    assert score.fluctuation.l2 > score.l2 and score.fluctuation.cos_sim < score.cos_sim
    # exact velocities: the swirl is left, and the growth of the rise inside a layer, all of it right
    exact = make_gaussians(4000, seed=7, velocity=plume(g.position.astype(float)))
    f = dve_sequence(exact, Sequence([0.0], sequence.at)).fluctuation
    assert f.l2 == pytest.approx(0, abs=1e-5) and f.cos_sim == pytest.approx(1, abs=1e-5)


def test_uniform_flow_has_no_fluctuation():
    g = make_gaussians(500)
    f = dve_sequence(g, Sequence([0.0], lambda t: Analytic(lambda p: np.array([0, 0.1, 2.0]) + 0 * p))).fluctuation
    assert f.l2 is None and "same everywhere" in f.undefined


def test_one_gaussian():
    score = dve_sequence(make_gaussians(1), Sequence([0.0], lambda t: Analytic(plume)))
    assert score.l2 is not None and score.trivial_baselines["constant"].l2 == pytest.approx(0, abs=1e-12)
    assert score.fluctuation.l2 is None


def test_skill(case):
    _, _, score = case
    constant = score.trivial_baselines["constant"].pooled
    assert skill(constant, constant) == 0 and skill(score.trivial_baselines["zero"].pooled, constant) < 0
    assert skill(score.pooled, constant) == pytest.approx(1 - (score.l2 / constant.l2) ** 2)
    one = dve_sequence(make_gaussians(1), Sequence([0.0], lambda t: Analytic(plume)))
    assert skill(one.pooled, one.trivial_baselines["true_centre"].pooled) is not None


@pytest.mark.parametrize("seed", [0, 1, 12345])
@pytest.mark.parametrize("draw", ["standard_normal", "permutation"])
def test_the_random_baseline_knows_nothing_of_a_users_script(seed, draw):
    """Gaussians at places of `default_rng(seed)`, in a flow away from the centre: random directions have CosSim 0.

    Its spread over draws is 1 / sqrt(3 n). With numbers of the same generator they would be the flow itself.
    """
    n = 4000
    rng = np.random.default_rng(seed)
    places = rng.standard_normal((n, 3))
    if draw == "permutation":  # the second thing that is drawn
        places = places[rng.permutation(n)]
    g = replace(make_gaussians(n, seed=3), position=(0.1 * places).astype(np.float32))
    sequence = Sequence([0.0], lambda t: Analytic(lambda p: 10 * p))
    found = dve_sequence(replace(g, velocity=(places[::-1]).astype(np.float32).copy()), sequence).trivial_baselines
    assert abs(found["random"].cos_sim) < 5 / np.sqrt(3 * n)


def test_no_score_draws_from_a_generator_that_users_have():
    """`default_rng` stands in one place of what handles users' results."""
    root = Path(__file__).parents[2] / "gof"
    rooms = [*(root / "evaluate").rglob("*.py"), *(root / "look").rglob("*.py")]
    assert len(rooms) > 30
    drawn = [path.name for path in rooms if "np.random." in path.read_text().replace("np.random.Generator", "")]
    assert drawn == ["intervals.py"]


def test_purposes_have_numbers_of_their_own_and_keep_them():
    one, other = own_generator("one").random(100), own_generator("other").random(100)
    assert (one == own_generator("one").random(100)).all()
    assert not np.isin(one, np.concatenate([other, np.random.default_rng(0).random(1000)])).any()
