"""Velocity fields against closed forms and scipy, and the chunked store."""

import json
import shutil

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gof.core.errors import DataFormatError
from gof.core.fields import VelocityField, VelocitySequence, _all_finite


def linear_field(matrix, offset, resolution=(6, 7, 8), origin=(-1, 2, 0.5), voxel=0.25, time_s=0.0):
    empty = VelocityField.from_array(np.zeros((*resolution, 3)), origin, voxel, time_s)
    return VelocityField(empty.cell_centers() @ np.transpose(matrix) + offset, empty.index_to_world, time_s)


def test_a_linear_field_is_sampled_exactly_between_the_outer_centres():
    rng = np.random.default_rng(0)
    matrix, offset = rng.normal(size=(3, 3)), rng.normal(size=3)
    field = linear_field(matrix, offset)
    centers = field.cell_centers()
    points = rng.uniform(centers.min((0, 1, 2)), centers.max((0, 1, 2)), (200, 3))
    np.testing.assert_allclose(field.sample(points), points @ matrix.T + offset, atol=2e-6)


def test_sampling_equals_scipy_everywhere_inside():
    rng = np.random.default_rng(1)
    field = VelocityField.from_array(rng.normal(size=(5, 9, 4, 3)), (0, 0, 0), 0.5)
    points = rng.uniform(0, 1, (500, 3)) * np.array([5, 9, 4]) * 0.5
    index = field.to_index(points) - 0.5
    expected = np.stack(
        [map_coordinates(field.velocity[..., c], index.T, order=1, mode="nearest") for c in range(3)], -1
    )
    np.testing.assert_allclose(field.sample(points), expected, atol=2e-6)


def test_rotated_domain_gives_the_field_at_the_rotated_point():
    rng = np.random.default_rng(2)
    velocity = rng.normal(size=(4, 4, 4, 3)).astype(np.float32)
    plain = VelocityField.from_array(velocity, (0, 0, 0), 0.5)
    angle = 0.7
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = R, [3, -1, 2]
    turned = VelocityField(velocity @ R.T.astype(np.float32), placed @ plain.index_to_world)
    points = rng.uniform(0, 2, (50, 3))
    np.testing.assert_allclose(turned.sample(points @ R.T + placed[:3, 3]), plain.sample(points) @ R.T, atol=1e-5)
    assert turned.voxel_size == pytest.approx(0.5)


def test_borders_outside_and_bad_points():
    field = VelocityField.from_array(np.ones((3, 1, 2, 3)), (0, 0, 0), 1.0)
    points = np.array([[0, 0, 0], [3, 1, 2], [-1e-3, 0.5, 0.5], [np.nan, 0, 0], [1e30, 0, 0]])
    np.testing.assert_array_equal(field.contains(points), [True, True, False, False, False])
    np.testing.assert_array_equal(field.sample(points)[:, 0], [1, 1, 0, 0, 0])
    assert field.sample(np.empty((0, 3))).shape == (0, 3)


@pytest.mark.parametrize(
    "velocity, voxel", [(np.zeros((3, 3, 3)), 1), (np.zeros((0, 3, 3, 3)), 1), (np.zeros((2, 2, 2, 3)), 0)]
)
def test_impossible_grids_are_refused(velocity, voxel):
    with pytest.raises(DataFormatError):
        VelocityField.from_array(velocity, (0, 0, 0), voxel)


def sequence(path, dtype="float32", n=3):
    rng = np.random.default_rng(0)
    fields = [VelocityField.from_array(rng.normal(size=(70, 5, 6, 3)), (0, 1, 2), 0.1, 0.04 * k) for k in range(n)]
    return VelocitySequence.create(path, fields, dtype), fields


@pytest.mark.parametrize("dtype, bound", [("float32", 1e-6), ("float16", 2e-3)])
def test_store_round_trip_and_time_interpolation(tmp_path, dtype, bound):
    _, fields = sequence(tmp_path / "v.zarr", dtype)
    store = VelocitySequence.open(tmp_path / "v.zarr")
    np.testing.assert_allclose(store.times_s, [0, 0.04, 0.08])
    for field in fields:
        np.testing.assert_allclose(store.at(field.time_s).velocity, field.velocity, atol=bound)
    between = store.at(0.05)
    np.testing.assert_allclose(between.velocity, 0.75 * fields[1].velocity + 0.25 * fields[2].velocity, atol=2 * bound)
    np.testing.assert_allclose(between.index_to_world, fields[0].index_to_world)


def test_empty_chunks_are_not_stored(tmp_path):
    velocity = np.zeros((130, 64, 64, 3))
    velocity[3, 4, 5] = 1
    VelocitySequence.create(tmp_path / "v.zarr", [VelocityField.from_array(velocity, (0, 0, 0), 1.0)])
    assert sum(p.is_file() for p in (tmp_path / "v.zarr").rglob("*")) == 2, "zarr.json and one chunk of three"


def test_times_outside_the_clock_are_refused(tmp_path):
    store, _ = sequence(tmp_path / "v.zarr")
    for t in (-0.01, 0.081, 40.0, np.nan):
        with pytest.raises(DataFormatError, match="clock"):
            store.at(t)


@pytest.mark.parametrize(
    "change, error",
    [
        ({"schema": "other"}, "schema"),
        ({"version": 2}, "version 2"),
        ({"units": "cm/s"}, "cm/s"),
        ({"layout": "staggered"}, "staggered"),
        ({"time_s": [0, 0, 1]}, "increasing"),
        ({"time_s": [0, 1]}, "times"),
        ({"index_to_world": None}, "index_to_world"),
        ({"index_to_world": (1.7e308 * np.eye(4)).tolist()}, "index_to_world"),
        ({"index_to_world": np.diag([1.0, 1, 0, 1]).tolist()}, "index_to_world"),
        ({"index_to_world": np.diag([1.0, 1, 1, 2]).tolist()}, "index_to_world"),
    ],
)
def test_wrong_attributes_are_named(tmp_path, change, error):
    sequence(tmp_path / "v.zarr")
    path = tmp_path / "v.zarr" / "zarr.json"
    meta = json.loads(path.read_text())
    meta["attributes"] |= change
    meta["attributes"] = {k: v for k, v in meta["attributes"].items() if v is not None}
    path.write_text(json.dumps(meta))
    with pytest.raises(DataFormatError, match=error):
        VelocitySequence.open(tmp_path / "v.zarr")


def test_foreign_truncated_and_damaged_stores(tmp_path):
    with pytest.raises(DataFormatError, match="nothing"):
        VelocitySequence.open(tmp_path / "nothing")
    _, fields = sequence(tmp_path / "v.zarr")
    with pytest.raises(DataFormatError, match="exists already"):
        VelocitySequence.create(tmp_path / "v.zarr", fields)
    (tmp_path / "v.zarr" / "zarr.json").write_text("{")
    with pytest.raises(DataFormatError, match=r"v\.zarr"):
        VelocitySequence.open(tmp_path / "v.zarr")
    bad = VelocityField.from_array(np.full((2, 2, 2, 3), np.nan), (0, 0, 0), 1.0)
    damaged = VelocitySequence.create(tmp_path / "nan.zarr", [bad])
    with pytest.raises(DataFormatError, match="NaN"):
        damaged.at(0.0)
    sequence(tmp_path / "w.zarr")
    chunk = next(p for p in (tmp_path / "w.zarr" / "c").rglob("*") if p.is_file() and "/c/1/" in str(p))
    chunk.write_bytes(chunk.read_bytes()[:10])
    with pytest.raises(DataFormatError, match=r"w\.zarr.*frame 1"):
        VelocitySequence.open(tmp_path / "w.zarr").frame(1)


@pytest.mark.parametrize("value", [1.0, -65504.0, 6e-8, -0.0, np.nan, np.inf, -np.inf])
def test_nan_and_inf_are_seen_in_half_precision(value):
    cells = np.zeros((3, 4, 5), np.float16)
    cells[1, 2, 3] = value
    assert _all_finite(cells) == np.isfinite(value) == _all_finite(cells.astype(np.float32))


def moving_store(path, speeds, older=False):
    """A store of one field per speed, of which a still one is all zero; `older`: as versions before wrote it."""
    fields = [VelocityField.from_array(np.full((2, 2, 2, 3), v), (0, 0, 0), 1.0, 0.1 * k) for k, v in enumerate(speeds)]
    VelocitySequence.create(path, fields)
    if older:
        forget_every_frame(path)
        for k, speed in enumerate(speeds):
            if not speed:
                shutil.rmtree(path / f"c/{k}")
    return path


def forget_every_frame(path):
    described = json.loads((path / "zarr.json").read_text())
    del described["attributes"]["every_frame_stored"]
    (path / "zarr.json").write_text(json.dumps(described))


@pytest.mark.parametrize("lost", [[0], [1], [3], [0, 1, 2, 3]], ids=str)
def test_a_frame_without_its_chunks_is_lost_and_not_at_rest(tmp_path, lost):
    store = moving_store(tmp_path / "v.zarr", [0, 0, 3, 4])
    assert not VelocitySequence.open(store).frame(1).velocity.any(), "still air is stored, and read"
    for k in lost:
        shutil.rmtree(store / f"c/{k}")
    with pytest.raises(DataFormatError, match=rf"v\.zarr: frame {lost[0]} has none of its chunks.*copy it again"):
        VelocitySequence.open(store)


def test_an_emptied_folder_of_a_frame_is_a_lost_frame(tmp_path):
    store = moving_store(tmp_path / "v.zarr", [1, 2, 3])
    (store / "c/1/0/0/0/0").rename(store / "c/1/0/0/0/.0.part")
    with pytest.raises(DataFormatError, match="frame 1 has none"):
        VelocitySequence.open(store)


def test_older_and_foreign_stores_begin_at_rest_but_never_stop_in_between(tmp_path):
    store = VelocitySequence.open(moving_store(tmp_path / "begins.zarr", [0, 0, 3], older=True))
    assert not store.frame(0).velocity.any() and store.frame(2).velocity.all()
    for name, speeds in [("between", [0, 2, 0, 3]), ("ends", [0, 2, 0, 0]), ("never", [0, 0])]:
        with pytest.raises(DataFormatError, match="has none of its chunks"):
            VelocitySequence.open(moving_store(tmp_path / name, speeds, older=True))


@pytest.mark.parametrize("separator", ["/", "."])
def test_stores_of_the_zarr_library_with_frames_in_one_chunk_are_read(tmp_path, separator):
    zarr = pytest.importorskip("zarr", minversion="3")
    shape = (5, 2, 2, 2, 3)
    attributes = {"schema": "gof-velocity", "version": 1, "units": "m/s", "layout": "cell_centred"}
    attributes |= {"index_to_world": np.eye(4).tolist(), "time_s": [0, 1, 2, 3, 4]}
    array = zarr.create_array(
        str(tmp_path / "v"),
        shape=shape,
        chunks=(2, 2, 2, 2, 3),
        dtype="f4",
        compressors=zarr.codecs.GzipCodec(),
        chunk_key_encoding={"name": "default", "separator": separator},
        attributes=attributes,
    )
    array[3:] = 1.0
    store = VelocitySequence.open(tmp_path / "v")
    assert [bool(store.frame(k).velocity.any()) for k in range(5)] == [False, False, False, True, True]
    shutil.rmtree(tmp_path / "v/c/2") if separator == "/" else (tmp_path / "v/c.2.0.0.0.0").unlink()
    with pytest.raises(DataFormatError, match="frame 4 has none"):
        VelocitySequence.open(tmp_path / "v")


def test_grids_that_differ_by_voxels_are_no_sequence(tmp_path):
    """Also where 3 m are nothing beside the coordinates."""
    still = np.zeros((4, 4, 4, 3), np.float32)
    fields = [VelocityField.from_array(still, (x, 4e6, 0.0), 0.1, t) for t, x in enumerate((5e5, 5e5 + 3))]
    with pytest.raises(DataFormatError, match="share one grid"):
        VelocitySequence.create(tmp_path / "v.zarr", fields)
