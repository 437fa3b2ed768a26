"""The measure of fine noise: a flame's edge that was moved by a known distance, and one that moves at a known speed."""

import numpy as np
import pytest

from gof_benchmark.evidence.noise_truth import Step, edge_distance, own_speed, resampled


def test_an_edge_that_was_moved_by_three_voxels():
    x = np.arange(40)[:, None, None] * np.ones((40, 12, 12))
    wall = (x < 20).astype(float)
    assert edge_distance(np.roll(wall, 3, 0)[5:], wall[5:]).max() == 3
    assert edge_distance(wall, wall).max() == 0


@pytest.mark.parametrize("own_m_s", [0.0, 0.4, -0.8])
def test_the_speed_against_the_gas(own_m_s):
    """The gas and its flame move at 1.5 m/s along x, the drawn flame by `own_m_s` faster, for 5 ms."""
    cell_m, step_s, gas_m_s = 0.02, 0.005, 1.5
    coarse, fine = (24, 8, 8), (48, 16, 16)

    def step(time_s: float) -> tuple[Step, Step]:
        velocity = np.zeros((*coarse, 3))
        velocity[..., 0] = gas_m_s

        def flame(shape, speed):
            x = (np.arange(shape[0]) + 0.5) * 24 * cell_m / shape[0]
            front = 1 / (1 + np.exp((x - 0.24 - speed * time_s) / 0.03))
            return np.broadcast_to(front[:, None, None], shape)

        return Step(flame(coarse, gas_m_s), velocity, cell_m), Step(flame(fine, gas_m_s + own_m_s), velocity, cell_m)

    (plain, noise), (plain_next, noise_next) = step(0.0), step(step_s)
    own, gas = own_speed(plain, noise, plain_next, noise_next, step_s)
    assert own == pytest.approx(abs(own_m_s), abs=0.06) and gas == pytest.approx(gas_m_s, rel=1e-6)


def test_resampling_keeps_a_linear_field_in_place():
    x = np.arange(8) + 0.5
    found = resampled(np.broadcast_to(x[:, None, None], (8, 4, 4)), (16, 8, 8))[:, 0, 0]
    np.testing.assert_allclose(found[1:-1], ((np.arange(16) + 0.5) / 2)[1:-1], atol=1e-6)
