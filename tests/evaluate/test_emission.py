"""The score on the flame's own emission: places, the Gaussians' answer there, closed forms, and independence."""

import json

import numpy as np
import pytest

from gof.commands.evaluate import velocity_table
from gof.core.errors import DataFormatError
from gof.core.fields import VelocityField, VelocitySequence
from gof.core.grid_writer import GridWriter, scalar
from gof.core.zarr_array import ZarrArray
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.emission import EXPONENT, FlameGrid, score_on_emission, velocity_at
from tests.evaluate.analytic import make_gaussians
from tests.evaluate.synthetic_flame import flame_dataset, plume

TIMES = np.array([0.0, 0.1])
CELLS, SIDE = 70, 0.05  # across the border of two chunks
TO_WORLD = np.diag([SIDE, SIDE, SIDE, 1.0])
TO_WORLD[:3, 3] = [-1.75, -1.75, 0]


def write_grid(path, flame, quantity="flame"):
    """flame (T, X, Y, Z) as the generator stores it."""
    writer = GridWriter(path, flame.shape[1:], TO_WORLD, TIMES[: len(flame)], SIDE, "float16", scalar(quantity))
    for k, frame in enumerate(flame):
        writer.write_frame(k, frame.__getitem__)
    writer.finish()
    return path


def with_a_flame_grid(folder):
    """The dataset of `flame_dataset` with a grid that says that a column of 0.3 m burns evenly. Returns the folder."""
    dataset = Dataset.open(folder)
    attributes = {
        "schema": "gof-grid",
        "version": 1,
        "quantity": "flame",
        "index_to_world": dataset.velocity.index_to_world.tolist(),
        "time_s": dataset.velocity.times_s.tolist(),
    }
    array = ZarrArray.create(folder / "grids/flame.zarr", (9, 32, 32, 32), (1, 64, 64, 64), "float32", attributes)
    for frame in range(9):
        array.write(frame, np.broadcast_to(np.where(distance_from_axis(dataset) < 0.15, 0.7, 0), (32, 32, 32)))
    return folder


def distance_from_axis(dataset):
    return np.linalg.norm(dataset.velocity.at(0.0).cell_centers()[..., :2], axis=-1)


@pytest.fixture
def column(tmp_path):
    """A column of 0.5 m that burns evenly from 1 m to 3 m, in V = (0, 0, z) (1 + t)."""
    flame = np.zeros((2, CELLS, CELLS, CELLS))
    flame[:, 30:40, 30:40, 20:60] = 0.5
    z = (np.arange(CELLS) + 0.5) * SIDE
    fields = []
    for t in TIMES:
        v = np.zeros((CELLS, CELLS, CELLS, 3), np.float32)
        v[..., 2] = z * (1 + t)
        fields.append(VelocityField(v, TO_WORLD, t))
    return FlameGrid(write_grid(tmp_path / "flame.zarr", flame)), VelocitySequence.create(tmp_path / "v.zarr", fields)


def cloud(n=3000, **changes):
    """Gaussians all over the column and around it."""
    rng = np.random.default_rng(0)
    return make_gaussians(
        n,
        position=rng.uniform([-0.4, -0.4, 0.8], [0.4, 0.4, 3.2], (n, 3)),
        scale=rng.uniform(0.05, 0.1, (n, 3)),
        **changes,
    )


def test_places_follow_the_emission(tmp_path):
    rng = np.random.default_rng(0)
    flame = np.zeros((1, CELLS, CELLS, CELLS))
    flame[0, 5, 6, 7], flame[0, 66, 1, 69] = 1.0, 0.5
    grid = FlameGrid(write_grid(tmp_path / "f.zarr", flame))
    x = grid.places(0.0, 4000, rng)
    cell = np.floor((x - TO_WORLD[:3, 3]) / SIDE).astype(int)
    first = (cell == [5, 6, 7]).all(1)
    assert (first | (cell == [66, 1, 69]).all(1)).all() and first.mean() == pytest.approx(
        1 / (1 + 0.5**EXPONENT), abs=1e-3
    )
    inside = (x[first] - TO_WORLD[:3, 3]) / SIDE - [5, 6, 7]
    np.testing.assert_allclose(inside.mean(0), 0.5, atol=0.03)  # all over the cell
    np.testing.assert_allclose(inside.std(0), 1 / np.sqrt(12), atol=0.02)


def test_the_answer_of_overlapping_gaussians_by_hand():
    """Two Gaussians with different opacities and a turned, flat shape; a place out of reach of both."""
    g = make_gaussians(
        2,
        position=[[0, 0, 0], [0.1, 0, 0]],
        velocity=[[1, 0, 0], [0, 2, 0]],
        scale=[[0.1, 0.2, 0.05]] * 2,
        opacity=[0.8, 0.4],
        rotation=[[1, 0, 0, 0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]],
    )  # the second a quarter turn about z
    x = np.array([[0.05, 0.1, 0.02], [5, 5, 5]])
    a = 0.8 * np.exp(-0.5 * ((0.05 / 0.1) ** 2 + (0.1 / 0.2) ** 2 + (0.02 / 0.05) ** 2))
    b = 0.4 * np.exp(-0.5 * ((0.05 / 0.2) ** 2 + (0.1 / 0.1) ** 2 + (0.02 / 0.05) ** 2))
    velocity, cover = velocity_at(x, g, 0.0)
    np.testing.assert_allclose(velocity[0], [a / (a + b), 2 * b / (a + b), 0], rtol=1e-5)
    assert cover[0] == pytest.approx(a + b, rel=1e-5) and cover[1] == 0 and (velocity[1] == 0).all()


def test_one_vector_in_closed_form(column):
    """Estimated (0, 0, c) everywhere, true (0, 0, z): relative error of a constant over z in 1..3 m."""
    flame, truth = column
    got = score_on_emission(cloud(velocity=np.tile([0, 0, 1.5], (3000, 1))), truth, flame, TIMES)
    z2 = np.mean([(1 + t) ** 2 for t in TIMES]) * (3**3 - 1) / 3 / 2
    cross = np.mean([1 + t for t in TIMES]) * 2
    assert got.score.l2 == pytest.approx(np.sqrt((1.5**2 - 2 * 1.5 * cross + z2) / z2), rel=3e-3)
    assert got.score.cos_sim == pytest.approx(1, abs=1e-6) and got.uncovered == 0
    assert got.constant.l2 == pytest.approx(np.sqrt(1 - cross**2 / z2), rel=3e-3)  # the best single vector
    assert got.score.speed_ratio == pytest.approx(1.5 * cross / z2, rel=3e-3)


def test_right_velocities_are_right_wherever_they_sit(column):
    """Unlike DVE, it does not depend on where Gaussians are and how bright; half a column without any costs half."""
    flame, truth = column

    def right(g):
        return make_gaussians(
            len(g),
            **{n: getattr(g, n) for n in ("position", "scale", "opacity", "rotation")},
            velocity=g.position * [0, 0, 1],
        )

    full = score_on_emission(right(cloud()), truth, flame, TIMES[:1])
    assert full.score.l2 < 0.03 and full.score.cos_sim > 0.9999
    dim = cloud(opacity=np.where(cloud().position[:, 2] > 2, 0.9, 0.01))
    assert score_on_emission(right(dim), truth, flame, TIMES[:1]).score.l2 == pytest.approx(full.score.l2, abs=0.02)
    lower = cloud(opacity=np.where(cloud().position[:, 2] > 2, 0.0, 0.9))
    half = score_on_emission(right(lower), truth, flame, TIMES[:1])
    assert 0.3 < half.uncovered < 0.48  # Gaussians below 2 m reach a little above it, up to here:
    top = 3 - 2 * half.uncovered
    assert half.score.l2 == pytest.approx(
        np.sqrt((27 - top**3) / 26), abs=0.02
    ) and half.score.cos_sim == pytest.approx(1 - half.uncovered, abs=1e-3)


def test_the_same_places_for_every_result(column):
    flame, truth = column
    a, b = (score_on_emission(cloud(velocity=np.full((3000, 3), v)), truth, flame, TIMES) for v in (1.0, 2.0))
    assert a.constant == b.constant and a.score.n == b.score.n == 2048


def test_without_flame_and_with_bad_grids(tmp_path, column):
    flame, truth = column
    none = FlameGrid(write_grid(tmp_path / "none.zarr", np.zeros((2, CELLS, CELLS, CELLS))))
    got = score_on_emission(cloud(), truth, none, TIMES)
    assert got.score.l2 is None and got.uncovered == 0 and got.score.undefined
    with pytest.raises(DataFormatError, match="holds 'heat', not 'flame'"):
        FlameGrid(write_grid(tmp_path / "heat.zarr", np.zeros((2, 4, 4, 4)), "heat"))
    with pytest.raises(DataFormatError, match="zarr"):
        FlameGrid(tmp_path / "nothing.zarr")
    path = write_grid(tmp_path / "far.zarr", np.zeros((2, 4, 4, 4)))
    description = json.loads((path / "zarr.json").read_text())
    description["attributes"]["index_to_world"][0][3] = 1.7e308
    (path / "zarr.json").write_text(json.dumps(description))
    with pytest.raises(DataFormatError, match="index_to_world"):
        FlameGrid(path)
    with pytest.raises(DataFormatError, match="same times"):
        flame.places(0.05, 10, np.random.default_rng(0))
    with pytest.raises(DataFormatError, match="negative"):
        FlameGrid(write_grid(tmp_path / "bad.zarr", np.full((2, 4, 4, 4), -1.0))).places(
            0.0, 10, np.random.default_rng(0)
        )


@pytest.mark.long
def test_in_evaluate(tmp_path):
    """A dataset without the grid says so with null; with it the truth scores well, and the table shows it."""
    truth = flame_dataset(tmp_path / "data")
    dataset = Dataset.open(tmp_path / "data")
    assert evaluate(truth, dataset, images=False).dve.on_emission is None
    with_a_flame_grid(tmp_path / "data")
    scores = evaluate(truth, dataset, images=False)
    on = scores.dve.on_emission
    assert 0.1 < on.uncovered < 0.6 and on.n == 9 * 1024  # the column goes on where no Gaussian is
    # right where there are Gaussians, zero elsewhere: what is wrong is the missing part of the truth
    assert on.cos_sim == pytest.approx(1 - on.uncovered, abs=0.01)
    assert on.l2**2 == pytest.approx(1 - on.speed_ratio, abs=0.01)
    r = distance_from_axis(dataset)
    flow = plume(dataset.velocity.at(0.0).cell_centers()[r < 0.15])
    best_vector = np.sqrt(1 - (flow.mean(0) ** 2).sum() / (flow**2).sum(1).mean())
    assert on.constant.l2 == pytest.approx(best_vector, rel=0.02)
    assert "on the emission" in "".join(str(c) for c in velocity_table(scores).columns[0].cells)
