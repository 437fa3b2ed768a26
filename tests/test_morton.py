"""The Morton order: a permutation that keeps neighbours together."""

import numpy as np

from gof.core.morton import morton_order


def test_a_grid_is_walked_octant_by_octant():
    x, y, z = np.mgrid[:2, :2, :2].reshape(3, -1)
    points = np.stack([x, y, z], 1) * 0.3 + [5, -7, 1e-3]
    np.testing.assert_array_equal(points[morton_order(points)], points[np.lexsort((x, y, z))])


def test_neighbours_in_space_are_near_in_memory():
    points = np.random.default_rng(0).random((4000, 3))
    order = morton_order(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(4000))
    step = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    assert step < 0.25 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


def test_no_point_one_point_and_equal_points():
    assert morton_order(np.zeros((0, 3))).tolist() == []
    assert morton_order(np.ones((1, 3))).tolist() == [0]
    assert morton_order(np.ones((5, 3))).tolist() == [0, 1, 2, 3, 4]
