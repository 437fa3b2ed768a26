"""Errors of vorticity and divergence against flows whose gradients are known."""

import numpy as np
import pytest

from gof.core.fields import VelocityField, VelocitySequence
from gof.evaluate.emission import FlameGrid
from gof.evaluate.eve import curl, gradient, score_gradients, six_sides
from tests.evaluate.analytic import make_gaussians
from tests.evaluate.test_emission import CELLS, TIMES, TO_WORLD, cloud, write_grid

SPIN = np.array([[0, -3.0, 0], [3.0, 0, 0], [0, 0, 0]])  # v = SPIN x: vorticity (0, 0, 6), no divergence
SWELL = np.diag([2.0, 0, 0])  # divergence 2, no vorticity


@pytest.fixture
def scene(tmp_path):
    """A burning column in v = (SPIN + SWELL) x, at two times."""
    flame = np.zeros((2, CELLS, CELLS, CELLS))
    flame[:, 32:38, 32:38, 20:30] = 0.5
    grid = VelocityField(np.zeros((CELLS,) * 3 + (3,), np.float32), TO_WORLD)
    flow = (grid.cell_centers() @ (SPIN + SWELL).T).astype(np.float32)
    truth = VelocitySequence.create(tmp_path / "v.zarr", [VelocityField(flow, TO_WORLD, t) for t in TIMES])
    return FlameGrid(write_grid(tmp_path / "flame.zarr", flame)), truth


def test_gradient_and_curl_of_a_linear_flow():
    places = np.random.default_rng(0).normal(size=(7, 3))
    matrix = np.random.default_rng(1).normal(size=(3, 3))
    found = gradient(six_sides(places, 0.1) @ matrix.T, 0.1)
    assert np.allclose(found, matrix.T)
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    assert np.allclose(curl(found), axis)


def lattice(flow: np.ndarray):
    """Equal Gaussians on a lattice, each with the flow at its centre: their mean is the flow itself, to 1e-6."""
    axes = np.arange(-0.7, 0.71, 0.07), np.arange(-0.7, 0.71, 0.07), np.arange(0.3, 2.3, 0.07)
    position = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    n = len(position)
    return make_gaussians(
        n,
        position=position,
        velocity=position @ flow.T,
        scale=np.full((n, 3), 0.07),
        opacity=np.full(n, 0.5),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
    )


@pytest.mark.parametrize(
    ("flow", "vorticity", "divergence"),
    [
        (SPIN + SWELL, 0, 0),
        (0 * SPIN, 1, 2 / np.sqrt(22)),  # |grad V|^2 = 9 + 9 + 4
        (0.5 * SPIN + SWELL, 0.5, 0),
        (SPIN + 3 * SWELL, 0, 4 / np.sqrt(22)),
    ],
)
def test_errors_are_those_of_the_flow(scene, flow, vorticity, divergence):
    flame, truth = scene
    found = score_gradients(lattice(flow), truth, flame, TIMES[:1])  # later they have moved
    assert found.vorticity_l2 == pytest.approx(vorticity, abs=0.02)
    assert found.divergence_l2 == pytest.approx(divergence, abs=0.02)
    assert found.still_divergence_l2 == pytest.approx(2 / np.sqrt(22), rel=1e-4)
    assert found.uncovered == 0


def test_where_nobody_answers_nothing_changes(scene):
    flame, truth = scene
    away = cloud(velocity=np.ones((3000, 3)))
    gone = type(away)(**{n: getattr(away, n) for n in away.__dataclass_fields__} | {"position": away.position + 9})
    found = score_gradients(gone, truth, flame, TIMES)
    assert (found.vorticity_l2, found.uncovered) == (pytest.approx(1, rel=1e-9), 1)
    assert found.divergence_l2 == found.still_divergence_l2


def test_a_flow_without_gradient_has_no_error(tmp_path, scene):
    flame, _ = scene
    still = [VelocityField(np.ones((CELLS,) * 3 + (3,), np.float32), TO_WORLD, t) for t in TIMES]
    found = score_gradients(cloud(), VelocitySequence.create(tmp_path / "w.zarr", still), flame, TIMES)
    assert (found.vorticity_l2, found.divergence_l2) == (None, None)
