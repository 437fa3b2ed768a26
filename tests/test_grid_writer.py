"""The writer of grids against the zarr package, and its behaviour when interrupted or misused."""

import json
import shutil

import numpy as np
import pytest
import zarr

from gof.core.errors import DataFormatError
from gof.core.fields import VelocitySequence
from gof.core.grid_writer import GridWriter

GRID = (70, 33, 130)  # two, one and three chunks
MATRIX = np.array([[0, -0.1, 0, 1], [0.1, 0, 0, 2], [0, 0, 0.1, 3], [0, 0, 0, 1]])
TIMES = np.array([0.0, 0.04, 0.08])


def velocity(frame: int) -> np.ndarray:
    """Noise in one corner of the grid only, so that most chunks are empty."""
    v = np.zeros((*GRID, 3), np.float32)
    v[:20, :, 60:70] = np.random.default_rng(frame).normal(size=(20, 33, 10, 3))
    return v


def writer(path, **changes) -> GridWriter:
    arguments = dict(grid=GRID, index_to_world=MATRIX, time_s=TIMES, voxel_size=0.1) | changes
    return GridWriter(path, **arguments)


def write_all(path, **changes) -> dict:
    store = writer(path, **changes)
    for frame in range(len(TIMES)):
        store.write_frame(frame, velocity(frame).__getitem__)
    return store.finish()


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_zarr_reads_it_bit_for_bit(tmp_path, dtype):
    attributes = write_all(tmp_path / "velocity.zarr", dtype=dtype)
    array = zarr.open_array(str(tmp_path / "velocity.zarr"), mode="r")
    assert array.dtype == dtype and array.shape == (3, *GRID, 3) and array.chunks == (1, 64, 64, 64, 3)
    assert dict(array.attrs) == attributes
    errors = []
    for frame in range(3):
        exact = velocity(frame)
        assert array[frame].tobytes() == exact.astype(dtype).tobytes()
        errors.append(np.abs(exact.astype(dtype).astype(float) - exact).max())
    assert attributes["storage_max_abs_error"] == max(errors)
    assert (max(errors) == 0) == (dtype == "float32")


def test_what_it_writes_is_read(tmp_path):
    write_all(tmp_path / "velocity.zarr", dtype="float32")
    sequence = VelocitySequence.open(tmp_path / "velocity.zarr")
    assert np.array_equal(sequence.times_s, TIMES)
    field = sequence.at(0.04)
    assert np.array_equal(field.velocity, velocity(1))
    assert np.allclose(field.index_to_world, MATRIX)


def test_empty_chunks_have_no_file(tmp_path):
    write_all(tmp_path / "velocity.zarr")
    folder = tmp_path / "velocity.zarr"
    files = sorted(str(p.relative_to(folder / "c")) for p in (folder / "c").rglob("*") if p.is_file())
    assert files == [f"{t}/0/0/{z}/0" for t in range(3) for z in (0, 1)]  # z 60..70 touches two of three
    assert sorted(p.name for p in folder.iterdir()) == ["c", "zarr.json"]


def test_interrupted_export_goes_on_with_the_next_frame(tmp_path):
    path = tmp_path / "velocity.zarr"
    store = writer(path)
    store.write_frame(0, velocity(0).__getitem__)
    calls = []

    def dies_in_second_chunk(where):
        calls.append(where)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return velocity(1)[where]

    with pytest.raises(KeyboardInterrupt):
        store.write_frame(1, dies_in_second_chunk)
    assert not path.exists()  # nobody takes half an array for a whole one

    store = writer(path)
    assert [store.has_frame(f) for f in range(3)] == [True, False, False]
    before = {p: p.stat().st_mtime_ns for p in path.with_name("velocity.zarr.partial").joinpath("c", "0").rglob("*")}
    store.write_frame(0, lambda where: pytest.fail("a finished frame was asked for again"))
    with pytest.raises(ValueError, match="frames \\[1, 2\\] are not written"):
        store.finish()
    for frame in (1, 2):
        store.write_frame(frame, velocity(frame).__getitem__)
    assert before == {p: p.stat().st_mtime_ns for p in before}
    store.finish()
    array = zarr.open_array(str(path), mode="r")
    assert all(np.array_equal(array[f], velocity(f).astype("f2")) for f in range(3))


def test_finished_array_is_left_alone(tmp_path):
    path = tmp_path / "velocity.zarr"
    attributes = write_all(path)
    store = writer(path)
    store.write_frame(0, lambda where: pytest.fail("a finished array was written again"))
    assert store.finish() == attributes


@pytest.mark.parametrize(
    "changes, word",
    [
        ({"dtype": "float32"}, "data_type"),
        ({"time_s": TIMES[:2]}, "shape"),
        ({"index_to_world": np.eye(4)}, "index_to_world"),
    ],
)
@pytest.mark.parametrize("finished", [True, False])
def test_other_array_is_an_error(tmp_path, changes, word, finished):
    path = tmp_path / "velocity.zarr"
    write_all(path) if finished else writer(path)
    with pytest.raises(DataFormatError, match=word):
        writer(path, **changes)


def test_foreign_and_truncated_folders_are_errors(tmp_path):
    foreign = tmp_path / "foreign.zarr"
    foreign.mkdir()
    (foreign / "notes.txt").write_text("mine")
    with pytest.raises(DataFormatError, match=r"foreign.zarr.*no zarr.json"):
        writer(foreign)
    assert (foreign / "notes.txt").read_text() == "mine"

    path = tmp_path / "velocity.zarr"
    write_all(path)
    text = (path / "zarr.json").read_text()
    (path / "zarr.json").write_text(text[: len(text) // 2])
    with pytest.raises(DataFormatError, match=r"zarr.json.*not valid JSON"):
        writer(path)
    (path / "zarr.json").write_text(json.dumps([1, 2]))
    with pytest.raises(DataFormatError, match="not a zarr v3 description"):
        writer(path)


@pytest.mark.parametrize(
    "bad, dtype, word", [(np.nan, "float32", "NaN"), (np.inf, "float16", "NaN or Inf"), (7e4, "float16", "float32")]
)
def test_values_that_cannot_be_stored(tmp_path, bad, dtype, word):
    store = writer(tmp_path / "velocity.zarr", dtype=dtype)
    broken = velocity(0)
    broken[3, 4, 65, 1] = bad
    with pytest.raises(ValueError, match=word):
        store.write_frame(0, broken.__getitem__)
    assert not store.has_frame(0)


@pytest.mark.parametrize(
    "changes",
    [
        {"dtype": "int8"},
        {"grid": (3, 0, 2)},
        {"time_s": []},
        {"time_s": [0, 0, 1]},
        {"time_s": [0, np.nan, 1]},
        {"index_to_world": np.zeros((4, 4))},
        {"index_to_world": np.full((4, 4), np.nan)},
        {"voxel_size": 0.0},
    ],
)
def test_bad_arguments(tmp_path, changes):
    with pytest.raises(ValueError):
        writer(tmp_path / "velocity.zarr", **changes)
    assert list(tmp_path.iterdir()) == []


def test_still_air_is_a_valid_array(tmp_path):
    store = writer(tmp_path / "velocity.zarr", time_s=[0.0])
    store.write_frame(0, np.zeros((*GRID, 3)).__getitem__)
    store.finish()
    array = zarr.open_array(str(tmp_path / "velocity.zarr"), mode="r")
    assert not array[:].any()
    files = [p for p in (tmp_path / "velocity.zarr" / "c").rglob("*") if p.is_file()]
    assert len(files) == 1, "of a frame at rest one chunk is stored: without any it is a lost one"
    assert array.attrs["every_frame_stored"]


def test_a_store_that_a_version_before_began_does_not_vouch_for_its_frames(tmp_path):
    path, still = tmp_path / "velocity.zarr", np.zeros((*GRID, 3))
    store = writer(path)
    for frame in range(3):
        store.write_frame(frame, (velocity(frame) if frame else still).__getitem__)
    shutil.rmtree(tmp_path / "velocity.zarr.partial/c/0")  # as that version left out a frame at rest
    assert "every_frame_stored" not in writer(path).finish()
    assert not VelocitySequence.open(path).frame(0).velocity.any()
    assert writer(path).finished, "generated again, it is kept"


def test_a_frame_that_was_cut_off_is_written_anew(tmp_path):
    """Where the second run has no motion, the first one's is gone."""

    def cut_off(where):
        if where[0].start:
            raise KeyboardInterrupt
        return np.ones([part.stop - part.start for part in where] + [3])

    with pytest.raises(KeyboardInterrupt):
        writer(tmp_path / "v.zarr", time_s=TIMES[:1]).write_frame(0, cut_off)
    store = writer(tmp_path / "v.zarr", time_s=TIMES[:1])
    store.write_frame(0, np.zeros((*GRID, 3)).__getitem__)
    store.finish()
    assert not VelocitySequence.open(tmp_path / "v.zarr").frame(0).velocity.any()
