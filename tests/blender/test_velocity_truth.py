"""The velocity ground truth: a real bake, the solver's own advection, and the exported metres per second."""

import numpy as np
import pytest

from gof.core.fields import VelocitySequence
from tests.blender import smoke_transport


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("velocity_truth")


@pytest.mark.blender
@pytest.mark.timeout(240)  # 6 s each on two free cores
@pytest.mark.parametrize("case", ["plain", "slow_50fps_2m"])
def test_exported_velocity_moves_the_smoke(folder, case):
    result = smoke_transport.measure(smoke_transport.run_case(case, folder))
    assert result.largest_motion_cells > 0.05  # else every factor would fit
    factors, shifts = result.factors, result.shifts
    for wrong in (0.5, 0.8, 1.25, 2.0):
        assert factors[1.0] < 0.02 < 0.1 < factors[wrong], f"factor {wrong}: {factors}"
    assert result.fitted_factor == pytest.approx(1.0, abs=0.03)
    assert np.allclose(result.fitted_per_frame, 1.0, atol=0.03)
    for shift in (-0.5, 0.5):
        assert shifts[0.0] < 0.02 < 0.1 < shifts[shift], f"shift of {shift} cells: {shifts}"
    # The grid sits where the emitter is: the first smoke is centred on it.
    assert np.abs(result.emitter_offset_cells).max() < 0.1
    assert result.cells_with_velocity > 0.999
    assert result.storage_max_abs_error < 1e-3 * result.fastest_m_s


@pytest.mark.blender
@pytest.mark.timeout(240)  # 6 s each on two free cores
def test_posed_domain_gives_the_turned_field(folder):
    """A turned, moved domain with unapplied scale holds the same flow, seen in world axes."""
    plain, posed = (
        VelocitySequence.open(smoke_transport.run_case(name, folder) / "velocity.zarr") for name in ("plain", "posed")
    )
    case = smoke_transport.CASES["posed"]
    x, y, z = np.radians(case.rotation_deg)
    turn_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    turn_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    turn_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    rotation = turn_z @ turn_y @ turn_x
    points = np.random.default_rng(0).uniform([-0.4, -0.4, -0.6], [0.4, 0.4, 0.6], (2000, 3))
    for frame in (2, 6, 11):
        seen = posed.frame(frame).sample(points @ rotation.T + case.translation_m)
        expected = plain.frame(frame).sample(points) @ rotation.T
        speed = np.linalg.norm(expected, axis=1).max()
        assert speed > 0.05
        assert np.abs(seen - expected).max() < 0.005 * speed
    # The centre of the domain box is where the object was put.
    centre = posed.index_to_world @ [*(np.array(posed.frame(0).resolution) / 2), 1]
    assert np.allclose(centre[:3], case.translation_m, atol=1e-6)


def test_twin_moves_by_whole_cells_exactly():
    grid = np.zeros((12, 10, 11))
    grid[3:6, 4:6, 4:7] = np.random.default_rng(0).uniform(size=(3, 2, 3))
    moved = smoke_transport.advect(grid, np.broadcast_to([2.0, 1.0, -1.0], (*grid.shape, 3)))
    assert np.allclose(moved, np.roll(grid, (2, 1, -1), (0, 1, 2)), atol=1e-12)


def test_twin_keeps_the_range_and_survives_large_steps():
    rng = np.random.default_rng(1)
    grid = rng.uniform(size=(9, 8, 7))
    for size in (0.3, 3.0, 1e6):
        moved = smoke_transport.advect(grid, rng.normal(scale=size, size=(9, 8, 7, 3)))
        assert np.isfinite(moved).all() and moved.min() >= 0 and moved.max() <= 1
