"""Reading a chunked store only where Gaussians are gives what the whole field gives."""

import json

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.fields import CHUNK, VelocityField, VelocitySequence
from gof.evaluate import dve_sequence
from gof.evaluate import sparse_grid as bricks
from gof.evaluate.expectation import expected_velocity, expected_velocity_plain
from gof.evaluate.grid_quadrature import expected_velocity_on_grid
from gof.evaluate.sparse_grid import Bricks, StoredField, StoredFields
from tests.evaluate.analytic import Sequence, make_gaussians

SHAPE = (150, 70, 130)  # 3 x 2 x 3 chunks, most of them cut off by the end of the grid


@pytest.fixture(scope="module", params=["float32", "float16"])
def store(request, tmp_path_factory):
    """Two frames of noise with some empty chunks, so that full ones border on empty ones on every side."""
    rng = np.random.default_rng(0)
    fields = []
    for t in (0.0, 0.1):
        v = rng.normal(size=(*SHAPE, 3)).astype(request.param)
        v[:64, :64, :64] = 0
        v[64:128, 64:, 64:128] = 0
        v[128:, :64, 128:] = 0
        fields.append(VelocityField.from_array(v, (-0.75, -0.35, -0.65), 0.01, t))
    path = tmp_path_factory.mktemp("store") / "v.zarr"
    return VelocitySequence.create(path, fields, request.param)


def gaussians(n=3000):
    rng = np.random.default_rng(1)
    return make_gaussians(
        n,
        position=rng.uniform(-0.8, 0.8, (n, 3)) * [1, 0.5, 0.9],
        scale=10 ** rng.uniform(-3.5, -1.2, (n, 3)),
        t_mu=np.full(n, 0.05),
        t_sigma=np.full(n, 0.1),
    )


def shape_of(g):
    return g.position.astype(float), g.scale.astype(float), g.rotation


@pytest.mark.parametrize("time_s", [0.0, 0.1, 0.03])
@pytest.mark.long
def test_same_as_the_whole_field(store, time_s):
    g = gaussians()
    whole, stored = store.at(time_s), StoredField(store, time_s)
    twin = expected_velocity_plain(whole, *shape_of(g), 3)
    for got in (
        expected_velocity_on_grid(stored, *shape_of(g), 3),
        expected_velocity_on_grid(whole, *shape_of(g), 3),
        expected_velocity(StoredField(store, time_s), *(a[:1500] for a in shape_of(g)), 3),
    ):
        for name, a, b in zip(got._fields, got, twin, strict=True):
            np.testing.assert_allclose(a, b[: len(a)], atol=5e-6, err_msg=name)
    points = np.random.default_rng(2).uniform(-0.8, 0.8, (2000, 3))
    np.testing.assert_allclose(stored.sample(points), whole.sample(points), atol=1e-6)
    np.testing.assert_array_equal(stored.contains(points), whole.contains(points))


@pytest.mark.long
def test_parts_do_not_change_the_answer(store, monkeypatch):
    g = gaussians()
    whole = expected_velocity_on_grid(StoredField(store, 0.0), *shape_of(g), 3)
    monkeypatch.setattr(bricks, "POOL_BYTES", 3 * bricks.EDGE**3 * 16)
    sizes, pool = [], Bricks.pool
    monkeypatch.setattr(Bricks, "pool", lambda self, needed: sizes.append(pool(self, needed)) or sizes[-1])
    for a, b in zip(whole, expected_velocity_on_grid(StoredField(store, 0.0), *shape_of(g), 3), strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(sizes) > 3
    points, read = np.random.default_rng(2).uniform(-0.8, 0.8, (2000, 3)), len(sizes)
    np.testing.assert_allclose(StoredField(store, 0.0).sample(points), store.at(0.0).sample(points), atol=1e-6)
    assert len(sizes) > read + 3 and max(p.held.sum() for p in sizes) < 18


def test_only_touched_chunks_are_read(store, monkeypatch):
    g = make_gaussians(
        2000,
        position=np.random.default_rng(3).normal([0.2, -0.2, 0.3], 0.01, (2000, 3)),
        scale=np.full((2000, 3), 0.003),
    )
    read = []
    original = VelocitySequence.chunk
    monkeypatch.setattr(
        VelocitySequence, "chunk", lambda self, index, number: read.append(number) or original(self, index, number)
    )
    dve_sequence(g, store, [0.0], trivial_baselines=False)
    # x 0.2 m is cell 95, y -0.2 cell 15, z 0.3 cell 95: with the spread of 10 cells, chunk (1, 0, 1) and no other
    assert read == [(1, 0, 1)]


def test_touched_chunks_against_counting():
    rng = np.random.default_rng(4)
    field = VelocityField(np.broadcast_to(np.float32(0), (200, 100, 300, 3)), np.eye(4))
    low = rng.integers(-80, 320, (40, 3))
    high = low + rng.integers(0, 90, (40, 3))
    expected = np.zeros((4, 2, 5), bool)
    size = np.array(field.resolution)
    for a, b in zip(low - bricks.MARGIN, high + bricks.MARGIN, strict=True):
        if (b < 0).any() or (a >= size).any():
            continue
        a, b = np.clip(a, 0, size - 1) // CHUNK, np.clip(b, 0, size - 1) // CHUNK
        expected[a[0] : b[0] + 1, a[1] : b[1] + 1, a[2] : b[2] + 1] = True
    np.testing.assert_array_equal(Bricks(field).touched(low, high), expected)


def test_every_node_falls_into_its_cell_range():
    from gof.core.rotations import rotation_matrices
    from gof.evaluate.quadrature import product_rule

    g = make_gaussians(500)
    field = VelocityField(np.zeros((4, 4, 4, 3)), np.diag([0.1, 0.3, 0.2, 1]))
    x, s, q = shape_of(g)
    nodes = product_rule(3)[0]
    low, high = Bricks(field).cell_ranges(x, s, np.abs(nodes).max())
    points = x[:, None] + np.einsum("nik,pk->npi", rotation_matrices(q) * s[:, None], nodes)
    index = np.floor(field.to_index(points.reshape(-1, 3)) - 0.5).reshape(points.shape)
    assert (index >= low[:, None]).all() and (index <= high[:, None]).all()


@pytest.mark.long
def test_sequence_scores_equal_those_of_whole_fields(store):
    g = gaussians()
    whole = Sequence(store.times_s, store.at)
    a, b = dve_sequence(g, store), dve_sequence(g, whole)
    assert a.l2 == pytest.approx(b.l2, rel=1e-6) and a.cos_sim == pytest.approx(b.cos_sim, abs=1e-6)


def test_frames_are_read_once_while_they_fit(tmp_path, monkeypatch):
    """Three sweeps over two frames; what is asked for in addition is read with what was there before."""
    values = [np.full((130, 4, 4, 3), speed, np.float32) for speed in (1, 2)]
    frames = [VelocityField.from_array(v, (0, 0, 0), 1.0, t) for v, t in zip(values, (0.0, 0.1), strict=True)]
    frames += [VelocityField.from_array(np.full((600, 4, 4, 3), 3, np.float32), (0, 0, 0), 1.0, 0.0)]
    store = VelocitySequence.create(tmp_path / "v.zarr", frames[:2])
    wide = VelocitySequence.create(tmp_path / "w.zarr", frames[2:])
    read = []
    monkeypatch.setattr(VelocitySequence, "chunk", _counted(VelocitySequence.chunk, read))

    def sweep(fields):
        return [fields.at(t).sample(np.full((1, 3), 2.0))[0, 0] for t in (0.0, 0.1)]

    fields = StoredFields(store)
    assert [sweep(fields) for _ in range(3)] == [[1, 2]] * 3
    once = len(read)
    monkeypatch.setattr(bricks, "KEPT_BYTES", 0)
    fields = StoredFields(store)
    assert [sweep(fields) for _ in range(3)] == [[1, 2]] * 3
    assert len(read) - once == 3 * once  # none is kept
    read.clear()
    field = StoredFields(wide).at(0.0)
    for x in (10.0, 500.0, 10.0, 500.0):
        assert field.sample(np.array([[x, 2, 2]]))[0].tolist() == [3, 3, 3]
    assert len(read) == len(set(read)) + 1  # the first chunk a second time, together with the last


def _counted(chunk, read):
    def of(self, index, number):
        read.append((index, number))
        return chunk(self, index, number)

    return of


def test_damaged_chunk_is_named_when_it_is_read(tmp_path):
    v = np.ones((300, 4, 4, 3), np.float32)  # five chunks
    v[66, 1, 1] = np.nan
    store = VelocitySequence.create(tmp_path / "v.zarr", [VelocityField.from_array(v, (0, 0, 0), 1.0)])
    g = make_gaussians(5, position=np.full((5, 3), 2.0), velocity=np.ones((5, 3)))
    assert dve_sequence(g, store).l2 == pytest.approx(0, abs=1e-6)  # far from the damage
    near = make_gaussians(5, position=np.tile([66.0, 2, 2], (5, 1)))
    with pytest.raises(DataFormatError, match=r"chunk \(1, 0, 0\) holds NaN"):
        dve_sequence(near, store)
    with pytest.raises(DataFormatError, match="outside the stored clock"):
        StoredField(store, 3.0).sample(np.zeros((1, 3)))


def test_chunks_that_are_not_stored_have_the_fill_value(tmp_path):
    """As zarr says: ambient wind, or NaN, which is an error; not rest."""
    v = np.full((128, 8, 8, 3), 2.0, np.float32)
    VelocitySequence.create(tmp_path / "v.zarr", [VelocityField.from_array(v, (0, 0, 0), 0.01, t) for t in (0.0, 1.0)])
    described = tmp_path / "v.zarr/zarr.json"
    for frame in (0, 1):
        (tmp_path / f"v.zarr/c/{frame}/1/0/0/0").unlink()
    one = make_gaussians(1, position=[[0.9, 0.04, 0.04]], velocity=[[2, 2, 2]], scale=[[0.005] * 3], t_mu=[0.0])
    for fill in (2.0, "NaN"):
        described.write_text(json.dumps(json.loads(described.read_text()) | {"fill_value": fill}))
        store = VelocitySequence.open(tmp_path / "v.zarr")
        if fill == "NaN":
            with pytest.raises(DataFormatError, match="NaN or Inf"):
                dve_sequence(one, store, times_s=[0.0], trivial_baselines=False)
        else:
            assert dve_sequence(one, store, times_s=[0.0], trivial_baselines=False).l2 < 1e-6
