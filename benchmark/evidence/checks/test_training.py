"""The aim of the flow prior's training, and whether the uncertainty that it learns is right, on made-up numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gof.reconstruct.flow_prior import FEATURES, VECTORS, evaluate_network  # noqa: E402
from gof.reconstruct.mean_speed import SpeedClues  # noqa: E402
from gof_benchmark.training.flow_prior import (  # noqa: E402
    LitVoxels,
    Scaling,
    TrainingFlame,
    fitted_pace,
    held_out_error,
    train_uncertainty,
    train_velocity,
    velocity_loss,
)


def samples(count: int = 4000, seed: int = 0) -> LitVoxels:
    """Gas that moves at twice its first vector where its first feature is positive, and rests elsewhere."""
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(count, len(FEATURES), generator=generator)
    vectors = torch.randn(count, VECTORS, 3, generator=generator)
    truth = 2 * vectors[:, 0] * (features[:, :1] > 0)
    one = torch.ones(count)
    return LitVoxels(features, vectors, truth, one, one / (truth**2).sum(-1).mean())


def test_a_velocity_of_zero_costs_two_and_the_truth_nothing():
    truth = torch.tensor([[3.0, 0, 4.0]] * 5)
    scale, weight = torch.full((5,), 1 / 25.0), torch.ones(5)
    assert float(velocity_loss(0 * truth, truth, scale, weight)) == pytest.approx(2)
    assert float(velocity_loss(truth, truth, scale, weight)) == pytest.approx(0, abs=0.05)
    assert float(velocity_loss(-truth, truth, scale, weight)) == pytest.approx(4 + 2, abs=0.1)


def test_every_flame_counts_alike():
    large, small = samples(4000), samples(40)
    both = LitVoxels.joined([large, small])
    assert float(both.weight[:4000].sum()) == pytest.approx(float(both.weight[4000:].sum()), rel=1e-5)


@pytest.mark.long
def test_what_holds_everywhere_is_learned():
    scaling, network = train_velocity([samples(seed=1), samples(seed=2)], members=2, steps=400)
    unseen = samples(seed=3)
    error = held_out_error(scaling, network, unseen)
    assert float((error**2).sum() / (unseen.truth**2).sum()) < 0.1


def test_a_pace_that_is_too_high_is_an_error():
    """A network that is right but for a pace of twice the true one is wrong by half of what it says."""
    scaling, right = train_velocity([samples(seed=1)], members=1, steps=1)
    unseen = samples(count=50, seed=3)
    said = held_out_error(scaling, right, unseen) + unseen.truth
    torch.testing.assert_close(held_out_error(scaling, right, replace(unseen, truth=said), pace=2.0), said / 2)


def test_the_pace_is_not_learned_from_flames_that_lie():
    """Five flames whose gas is twice as fast as it looks, and one that lies, whose gas is nine times as fast."""
    clues = SpeedClues(seen=1.0, buoyant=4.5, carried=0.6, slenderness=0.14, energy=1.0)
    flames = [TrainingFlame(clues, 2.0, samples(10), True)] * 5 + [TrainingFlame(clues, 9.0, samples(10), False)]
    assert fitted_pace([SimpleNamespace(flames=flames)]).of(clues) == pytest.approx(2.0)


@pytest.mark.long
def test_uncertainty_is_the_spread_of_the_errors():
    """Errors that are normal, and wider where the second feature is positive."""
    flames = [samples(seed=1), samples(seed=2)]
    errors = [
        torch.randn(len(f), 3, generator=torch.Generator().manual_seed(9)) * spread(f.features)[:, None] for f in flames
    ]
    uncertainty = train_uncertainty(Scaling.of(LitVoxels.joined(flames)), flames, errors, steps=600)
    unseen = replace(samples(seed=3), features=samples(seed=3).features)
    scaled = Scaling.of(LitVoxels.joined(flames))(unseen.features).numpy()
    sd = np.exp(evaluate_network(uncertainty, scaled)[0, :, 0])
    wide = unseen.features[:, 1].numpy() > 0.3
    narrow = unseen.features[:, 1].numpy() < -0.3
    assert np.median(sd[wide]) == pytest.approx(1.2, rel=0.15)
    assert np.median(sd[narrow]) == pytest.approx(0.3, rel=0.15)


def spread(features):
    """m/s."""
    return torch.where(features[:, 1] > 0, 1.2, 0.3)
