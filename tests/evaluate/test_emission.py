"""The flame's true light: its places, and what is wrong with a grid."""

import json
import shutil

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.fields import VelocityField, VelocitySequence
from gof.core.grid_writer import GridWriter, scalar
from gof.core.zarr_array import ZarrArray
from gof.dataset import Dataset
from gof.evaluate.emission import EXPONENT, FlameGrid
from gof.evaluate.eve import score_eve
from tests.evaluate.analytic import make_gaussians

TIMES = np.array([0.0, 0.1])
CELLS, SIDE = 70, 0.05  # across the border of two chunks
TO_WORLD = np.diag([SIDE, SIDE, SIDE, 1.0])
TO_WORLD[:3, 3] = [-1.75, -1.75, 0]


def write_grid(path, flame, quantity="flame", times_s=TIMES):
    """flame (T, X, Y, Z) as the generator stores it."""
    writer = GridWriter(path, flame.shape[1:], TO_WORLD, times_s[: len(flame)], SIDE, "float16", scalar(quantity))
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


def test_without_flame_and_with_bad_grids(tmp_path, column):
    flame, truth = column
    none = FlameGrid(write_grid(tmp_path / "none.zarr", np.zeros((2, CELLS, CELLS, CELLS))))
    got = score_eve(cloud(), truth, none, TIMES)
    assert got.pooled.l2 is None and got.empty == 0 and got.pooled.undefined
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


def test_dark_frames_of_an_older_store_are_noted_and_lost_ones_of_a_new_one_refused(tmp_path):
    flame = np.zeros((4, CELLS, CELLS, CELLS))
    flame[[1, 3]] = 0.5  # before it is lit there is none; between, it may have gone out
    path = write_grid(tmp_path / "flame.zarr", flame, times_s=np.arange(4) / 10)
    grid = FlameGrid(path)
    assert grid.dark_notes == [] and len(grid.light(0)[1]) == 0, "dark frames are stored"
    for frame in (0, 2):
        shutil.rmtree(path / f"c/{frame}")
    with pytest.raises(DataFormatError, match=r"flame\.zarr: frame 0 has none of its chunks \(2 of 4"):
        FlameGrid(path)
    described = json.loads((path / "zarr.json").read_text())
    del described["attributes"]["every_frame_stored"]
    (path / "zarr.json").write_text(json.dumps(described))
    grid = FlameGrid(path)
    assert grid.dark == (2,) and "no chunk of 1 frames (the first is 2)" in grid.dark_notes[0]
    assert len(grid.light(2)[1]) == 0
