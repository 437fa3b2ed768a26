"""The stand-in of Grid4D's hash grid against the published formula, vertex by vertex, written here in float64; both as
it is compiled and by PyTorch."""

import itertools

import numpy as np
import pytest

from gof.core.errors import MissingDependencyError

torch = pytest.importorskip("torch")
pytest.importorskip("drjit")
from gof.on_cpu import hash_grid  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")

# Vertices along x, y, z of the coarsest level, and the factor to the next: level 0 fits its part of the table, level 1
# fills its part to the last row, level 2 has 9 x 12 x 15 vertices in 37 rows.
BASE, FACTOR = [3.0, 4.0, 5.0], 1.7
VERTICES = [(3, 4, 5), (6, 7, 9), (9, 12, 15)]
ROWS = [70, 6 * 7 * 9, 37]
OFFSETS = np.cumsum([0, *ROWS])
CHANNELS = 2
POINTS = np.array(
    [
        [0.0, 0.0, 0.0],
        [1.0, 1.0, 1.0],
        [0.0, 1.0, 0.5],
        [1.0, 0.37, 0.0],
        [0.5, 0.5, 0.5],
        [0.11, 0.83, 0.42],
        [0.97, 0.03, 0.61],
        [0.25, 0.71, 0.999],
    ]
)
OUTSIDE = np.array([[-1e-4, 0.5, 0.5], [0.5, 1.0001, 0.5], [2.0, -3.0, 0.1], [np.nan, 0.5, 0.5]])


def row(vertex, level: int) -> int:
    """Equation 4 of Instant-NGP where a level does not fit its part of the table; else its vertices one by one."""
    counts = VERTICES[level]
    if np.prod(counts) <= ROWS[level]:
        number = vertex[0] + counts[0] * vertex[1] + counts[0] * counts[1] * vertex[2]
    else:
        number = 0
        for place, prime in zip(vertex, (1, 2654435761, 805459861), strict=True):
            number ^= (int(place) * prime) % 2**32
    return int(OFFSETS[level]) + number % ROWS[level]


def features(points, table):
    """(N, L C): sums over the corners of each point's cell, weights by smoothsteps."""
    found = np.zeros((len(points), len(ROWS) * CHANNELS))
    for n, point in enumerate(points):
        if not np.all((point >= 0) & (point <= 1)):
            continue
        for level in range(len(ROWS)):
            place = point * (np.array(BASE) * FACTOR**level - 1)
            cell = np.floor(place).astype(int)
            t = place - cell
            t = 3 * t**2 - 2 * t**3
            for corner in itertools.product((0, 1), repeat=3):
                weight = np.prod([t[d] if up else 1 - t[d] for d, up in enumerate(corner)])
                columns = slice(CHANNELS * level, CHANNELS * (level + 1))
                found[n, columns] += weight * table[row(cell + corner, level)]
    return found


def constants(dtype=torch.float64):
    offsets = torch.tensor(OFFSETS, dtype=torch.int32)
    return offsets, torch.full((3,), np.log2(FACTOR), dtype=dtype), torch.tensor(BASE, dtype=dtype)


def encode(points, table):
    points, table = torch.as_tensor(points), torch.as_tensor(table)
    offsets, factor, base = constants(points.dtype)
    outputs = torch.full((len(ROWS), len(points), CHANNELS), np.nan, dtype=points.dtype)
    sizes = (len(points), 3, CHANNELS, len(ROWS))
    forward = hash_grid.backend()._backend.hash_encode_forward
    forward(points, table, offsets, outputs, *sizes, factor, base, False, torch.empty(1))
    return outputs.permute(1, 0, 2).reshape(len(points), -1)


def gradients(grad, points, table, wanted=True):
    points, table = torch.as_tensor(points), torch.as_tensor(table)
    offsets, factor, base = constants()
    grad = torch.as_tensor(grad).reshape(len(points), len(ROWS), CHANNELS).permute(1, 0, 2).contiguous()
    of_table, of_points = torch.zeros_like(table), torch.zeros_like(points)
    sizes = (len(points), 3, CHANNELS, len(ROWS))
    backward = hash_grid.backend()._backend.hash_encode_backward
    backward(grad, points, table, offsets, of_table, *sizes, factor, base, wanted, torch.empty(1), of_points)
    return of_table.numpy(), of_points.numpy()


@pytest.fixture
def table():
    return np.random.default_rng(3).normal(size=(int(OFFSETS[-1]), CHANNELS))


def test_the_scene_has_what_it_is_to_test():
    """Vertices by the formula of the levels' sizes; one cell of the finest level has corners that share a row."""
    for level, counts in enumerate(VERTICES):
        assert tuple(int(np.ceil(b * FACTOR**level - 1)) + 1 for b in BASE) == counts
    shared = 0
    for cell in itertools.product(range(8), range(11), range(14)):
        rows = [row(np.add(cell, corner), 2) for corner in itertools.product((0, 1), repeat=3)]
        shared += len(set(rows)) < len(rows)
    assert shared > 0


def test_features_are_those_of_the_formula(table):
    points = np.concatenate([POINTS, OUTSIDE, np.random.default_rng(5).uniform(size=(200, 3))])
    want = features(points, table)
    np.testing.assert_allclose(encode(points, table), want, atol=1e-12)
    assert not np.any(want[len(POINTS) : len(POINTS) + len(OUTSIDE)])
    single = encode(points.astype(np.float32), table.astype(np.float32))
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single, want, atol=1e-4)


def test_a_corner_of_the_cube_has_the_table_of_its_vertex(table):
    """No interpolation there: the first row of each level at 0."""
    want = [table[OFFSETS[0]], table[OFFSETS[1]], table[OFFSETS[2]]]
    np.testing.assert_allclose(encode(np.zeros((1, 3)), table)[0], np.concatenate(want), atol=1e-14)


def test_gradients_equal_central_differences(table):
    """Also of vertices that share a row, of points at 0 and 1 from inside, and none of points outside."""
    rng = np.random.default_rng(7)
    points = np.concatenate([rng.uniform(0.01, 0.99, (60, 3)), POINTS, OUTSIDE])
    grad = rng.normal(size=(len(points), len(ROWS) * CHANNELS))
    of_table, of_points = gradients(grad, points, table)
    for k in rng.choice(table.size, 40, replace=False):
        step = np.zeros(table.size)
        step[k] = 1e-3
        step = step.reshape(table.shape)
        slope = np.sum(grad * (features(points, table + step) - features(points, table - step))) / 2e-3
        assert of_table.flat[k] == pytest.approx(slope, abs=1e-9)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        inside = slice(0, 60)
        change = features(points[inside] + step, table) - features(points[inside] - step, table)
        slope = np.sum(grad[inside] * change, 1) / 2e-6
        np.testing.assert_allclose(of_points[inside, axis], slope, atol=1e-5)
    at_zero = 60
    assert not np.any(of_points[at_zero]), "a smoothstep begins flat"
    assert not np.any(of_points[-len(OUTSIDE) :])


def test_gradients_of_points_only_where_asked_for(table):
    grad = np.ones((len(POINTS), len(ROWS) * CHANNELS))
    of_table, of_points = gradients(grad, POINTS, table, wanted=False)
    assert np.any(of_table) and not np.any(of_points)
    # Weights of a point add up to 1, in each level and channel.
    assert of_table.sum() == pytest.approx(len(POINTS) * len(ROWS) * CHANNELS)


def test_second_derivatives_are_refused():
    with pytest.raises(MissingDependencyError, match="second derivatives"):
        hash_grid.backend()._backend.hash_encode_second_backward()
