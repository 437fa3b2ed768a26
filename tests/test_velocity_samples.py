"""True velocity at points and times, chunk by chunk, against whole fields, and of broken stores."""

import json

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.fields import VelocitySequence
from gof.core.grid_writer import GridWriter

GRID, TIMES = (70, 9, 66), (0.0, 0.1, 0.25)  # more than one chunk along x and z


def matrix() -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn * 0.05, [-1, 2, 0.5]
    return out


def write(path, dtype="float32", grid=GRID):
    rng = np.random.default_rng(2)
    writer = GridWriter(path, grid, matrix(), np.array(TIMES), 0.05, dtype)
    for frame in range(len(TIMES)):
        velocity = rng.normal(size=(*grid, 3))
        velocity[:64] *= frame != 1  # a chunk of zeros has no file
        writer.write_frame(frame, velocity.__getitem__)
    writer.finish()
    return path


@pytest.mark.parametrize("grid", [GRID, (5, 1, 4)])
@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_samples_equal_those_of_whole_fields(tmp_path, dtype, grid):
    store = write(tmp_path / "velocity.zarr", dtype, grid)
    truth = VelocitySequence.open(store)
    rng = np.random.default_rng(3)
    index = rng.uniform(-0.1, 1.1, (600, 3)) * grid
    points = index @ matrix()[:3, :3].T + matrix()[:3, 3]
    time_s = rng.choice([0.0, 0.1, 0.25, 0.04, 0.2], len(points))
    velocity, inside = truth.sample(points, time_s)
    for t in np.unique(time_s):
        rows, field = time_s == t, truth.at(t)
        assert np.array_equal(inside[rows], field.contains(points[rows]))
        assert np.allclose(velocity[rows], field.sample(points[rows]), atol=1e-5)
    assert 0 < inside.sum() < len(inside)
    assert np.abs(velocity[inside]).max() > 0.5 and (velocity[~inside] == 0).all()


def test_before_and_after_the_clip_is_its_first_and_last_frame(tmp_path):
    truth = VelocitySequence.open(write(tmp_path / "velocity.zarr", grid=(4, 4, 4)))
    point = (matrix() @ [2.2, 1.7, 2.4, 1])[None, :3]
    for outside, border in ((-1.0, 0.0), (9.0, 0.25)):
        assert np.array_equal(truth.sample(point, np.array([outside]))[0], truth.sample(point, np.array([border]))[0])


def test_no_points(tmp_path):
    velocity, inside = VelocitySequence.open(write(tmp_path / "velocity.zarr", grid=(4, 4, 4))).sample(
        np.zeros((0, 3)), np.zeros(0)
    )
    assert velocity.shape == (0, 3) and inside.shape == (0,)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda d: d.pop("shape"), "KeyError"),
        (lambda d: d["attributes"].update(schema="gof-grid"), "gof-grid"),
        (lambda d: d["attributes"].update(units="knots"), "knots"),
        (lambda d: d["codecs"].append({"name": "blosc"}), "blosc"),
        (lambda d: d["attributes"].update(index_to_world=np.zeros((4, 4)).tolist()), "index_to_world"),
        (lambda d: d["attributes"].update(time_s=[0.0]), "shape"),
    ],
)
def test_broken_description(tmp_path, change, message):
    file = write(tmp_path / "velocity.zarr", grid=(4, 4, 4)) / "zarr.json"
    description = json.loads(file.read_text())
    change(description)
    file.write_text(json.dumps(description))
    with pytest.raises(DataFormatError, match=message):
        VelocitySequence.open(tmp_path / "velocity.zarr")


def test_nothing_of_a_store_is_a_link_to_elsewhere(tmp_path):
    """Its bytes would be shown as velocities; inside the store a link may stand."""
    store, point = write(tmp_path / "velocity.zarr", grid=(4, 4, 4)), (matrix() @ [2, 2, 2, 1])[None, :3]
    chunk = store / "c" / "0" / "0" / "0" / "0" / "0"
    expected = VelocitySequence.open(store).sample(point, np.array([0.0]))[0]
    chunk.rename(store / "moved")
    chunk.symlink_to(store / "moved")
    np.testing.assert_array_equal(VelocitySequence.open(store).sample(point, np.array([0.0]))[0], expected)
    (store / "moved").rename(tmp_path / "moved")
    chunk.unlink()
    chunk.symlink_to(tmp_path / "moved")
    with pytest.raises(DataFormatError, match="points outside"):
        VelocitySequence.open(store).sample(point, np.array([0.0]))
    (store / "zarr.json").rename(tmp_path / "zarr.json")
    (store / "zarr.json").symlink_to(tmp_path / "zarr.json")
    with pytest.raises(DataFormatError, match="points outside"):
        VelocitySequence.open(store)


def test_a_damaged_chunk_and_another_folder(tmp_path):
    store = write(tmp_path / "velocity.zarr", grid=(4, 4, 4))
    chunk = store / "c" / "0" / "0" / "0" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:100])
    point = (matrix() @ [2, 2, 2, 1])[None, :3]
    with pytest.raises(DataFormatError, match="truncated"):
        VelocitySequence.open(store).sample(point, np.array([0.0]))
    with pytest.raises(DataFormatError, match="not a readable zarr array|no such file"):
        VelocitySequence.open(tmp_path)
