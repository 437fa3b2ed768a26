"""Our reader and writer of chunked arrays against the zarr library, and stores that nobody vouches for."""

import gzip
import json
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gof.core.errors import DataFormatError
from gof.core.zarr_array import ZarrArray

zarr = pytest.importorskip("zarr", minversion="3")
from zarr.codecs import BloscCodec, BytesCodec, GzipCodec, ZstdCodec  # noqa: E402

GZIP, ZSTD, BLOSC = GzipCodec(level=3), ZstdCodec(level=1), BloscCodec()


def values(shape, dtype="float32", seed=0):
    """Random numbers with a corner of zeros, so that some chunks are not stored."""
    out = np.random.default_rng(seed).normal(size=shape).astype(dtype)
    out[(slice(0, 1), *(slice(0, n // 2 + 2) for n in shape[1:]))] = 0
    return out


SHAPES = [("float16", (2, 9, 5, 3), (1, 4, 4, 3)), ("float64", (7,), (3,))]


@pytest.mark.parametrize("separator", ["/", "."])
@pytest.mark.parametrize("packing", [None, GZIP, ZSTD], ids=["plain", "gzip", "zstd"])
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize(("dtype", "shape", "chunks"), SHAPES)
def test_reads_what_the_library_wrote(tmp_path, dtype, shape, chunks, endian, packing, separator):
    wanted = values(shape, dtype)
    store = zarr.create_array(
        str(tmp_path / "a"),
        shape=shape,
        chunks=chunks,
        dtype=dtype,
        fill_value=2.5,
        serializer=BytesCodec(endian=endian),
        compressors=packing,
        chunk_key_encoding={"name": "default", "separator": separator},
        attributes={"units": "m/s"},
    )
    store[: shape[0] - 1] = wanted[:-1]
    wanted[-1] = 2.5 if shape[0] - 1 <= (shape[0] - 1) // chunks[0] * chunks[0] else store[-1]
    array = ZarrArray.open(tmp_path / "a")
    assert (array.shape, array.chunks, array.attributes) == (shape, chunks, {"units": "m/s"})
    assert array.dtype.newbyteorder("=") == dtype
    np.testing.assert_array_equal(array[()], wanted)
    np.testing.assert_array_equal(array[(1,)], wanted[1])
    np.testing.assert_array_equal(array[(slice(1, 99),)], wanted[1:])
    if len(shape) > 1:
        np.testing.assert_array_equal(array[1, 3:8, 4], wanted[1, 3:8, 4])
        np.testing.assert_array_equal(array[1, 4:4], wanted[1, 4:4])
    with pytest.raises(IndexError, match="index"):
        array[(shape[0],)]


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_the_library_reads_what_was_written(tmp_path, dtype):
    wanted = values((2, 9, 5, 3), dtype)
    array = ZarrArray.create(tmp_path / "a", wanted.shape, (1, 4, 4, 3), dtype, {"time_s": [0.0, 0.5]})
    for frame in range(2):
        array.write(frame, wanted[frame])
    store = zarr.open_array(str(tmp_path / "a"), mode="r")
    np.testing.assert_array_equal(store[:], wanted)
    assert dict(store.attrs) == {"time_s": [0.0, 0.5], "every_frame_stored": True} and store.chunks == (1, 4, 4, 3)
    assert store.nchunks_initialized == 2 * 3 * 2 - 1, "one chunk is all zero"
    with pytest.raises(ValueError, match="is not a frame of"):
        array.write(0, wanted)


def made(folder, **changes):
    """A small store; parts of its zarr.json replaced."""
    array = ZarrArray.create(folder / "a", (1, 8, 8), (1, 8, 8), "float32", {})
    array.write(0, np.ones((8, 8)))
    file = folder / "a/zarr.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))
    return folder / "a"


@pytest.mark.parametrize("packing", [BLOSC, [GZIP, ZSTD]], ids=["blosc", "two"])
def test_stores_packed_in_another_way_are_refused_with_a_remedy(tmp_path, packing):
    zarr.create_array(str(tmp_path / "a"), shape=(4,), dtype="f4", compressors=packing)
    with pytest.raises(DataFormatError, match=r"a: not a readable zarr array.*codecs.*GzipCodec\(\)"):
        ZarrArray.open(tmp_path / "a")


def test_shards_are_refused(tmp_path):
    zarr.create_array(str(tmp_path / "a"), shape=(8,), shards=(8,), chunks=(4,), dtype="f4")
    with pytest.raises(DataFormatError, match=r"codecs.*sharding"):
        ZarrArray.open(tmp_path / "a")


def zeros(size):
    # without the clock, which gzip would write into the chunk
    return gzip.compress(bytes(size), mtime=0)


@pytest.mark.parametrize(
    ("chunk", "error"),
    [
        pytest.param(zeros(2**28), "more than 256 bytes of 256", id="bomb"),
        pytest.param(zeros(255), "255 bytes of 256", id="short"),
        pytest.param(zeros(256)[:-3], "ends too early", id="cut"),
        pytest.param(zeros(256)[:-8] + b"\0" * 8, "incorrect data check", id="wrong-checksum"),
        pytest.param(b"", "0 bytes", id="empty"),
        pytest.param(b"no gzip at all", "incorrect header", id="no-gzip"),
    ],
)
def test_a_damaged_chunk_is_named_and_never_larger_than_its_room(tmp_path, chunk, error):
    array = ZarrArray.open(made(tmp_path))
    (tmp_path / "a/c/0/0/0").write_bytes(chunk)
    tracemalloc.start()
    with pytest.raises(DataFormatError, match=rf"frame 0: c.0.0.0 cannot be decoded.*{error}"):
        array[(0,)]
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


JSON = st.recursive(
    st.none() | st.integers() | st.floats() | st.text(max_size=4) | st.booleans(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
KEYS = ["zarr_format", "node_type", "shape", "data_type", "chunk_grid", "chunk_key_encoding", "fill_value", "codecs"]


@settings(deadline=None, max_examples=200)
@given(st.dictionaries(st.sampled_from([*KEYS, "attributes"]), JSON, min_size=1, max_size=3))
def test_a_strange_description_is_read_or_refused_by_name(tmp_path_factory, changes):
    path = made(tmp_path_factory.mktemp("fuzz"), **changes)
    try:
        array = ZarrArray.open(path)
        assert np.prod(array.shape, dtype=float) < 0 or array.ndim == len(array.chunks)
    except DataFormatError as e:
        assert str(path) in str(e)


def test_a_frame_that_is_written_again_keeps_nothing(tmp_path):
    array, first = ZarrArray.create(tmp_path / "a", (1, 8, 8), (1, 4, 4), "float32", {}), np.ones((8, 8), np.float32)
    second = np.zeros_like(first)
    second[:4, :4] = 3
    for frame in (first, second, np.zeros_like(first)):
        array.write(0, frame)
        np.testing.assert_array_equal(array[(0,)], frame)
