"""How fast a flame is as a whole, on flames whose every number is known."""

import numpy as np
import pytest

from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.pace import FARTHEST, Pace, buoyant_speed, clues
from tests.reconstruct.plumes import box_of_voxels, field_of


def column(height_m: float = 1.5, seen: float = 0.5, radius_m: float = 0.05) -> FlameAxis:
    """An upright round flame that shines alike from its foot, z = 0, to its top, and rises at `seen` m/s."""
    voxels = box_of_voxels((12, 12, 60), height_m / 60)
    x, y, _ = voxels.center.T
    emission = np.exp(-(x**2 + y**2) / (2 * radius_m**2))
    velocity = np.broadcast_to([0, 0, seen], voxels.center.shape)
    return FlameAxis.of(field_of(voxels, [velocity] * 3, [emission] * 3))


@pytest.mark.parametrize("height_m", [0.1, 1.5, 20.0])
def test_buoyant_speed_of_a_column(height_m):
    """McCaffrey's 6.83 sqrt(z) m/s, averaged over a column that begins where 2 % of its light are below."""
    foot = 0.02 * height_m
    expected = 6.83 * 2 / 3 * (height_m - foot) ** 1.5 / height_m
    assert buoyant_speed(column(height_m, radius_m=height_m / 30)) == pytest.approx(expected, rel=0.02)


def test_a_line_is_found_again():
    """Flames that obey a line exactly, and one far from them that obeys it too."""
    axes = [column(h, s, r) for h in (0.6, 1.5, 4.0) for s in (0.4, 0.8) for r in (0.03 * h, 0.06 * h)]
    line = np.array([0.6, 0.9, -0.4])
    true = [axis.seen_speed * np.exp(line @ [1, *clues(axis)]) for axis in axes]
    fitted = Pace.fit(axes, true)
    assert fitted.of(axes[0]) == pytest.approx(true[0], rel=0.05)
    far = column(8.0, 0.9, 0.3)
    assert fitted.of(far) == pytest.approx(far.seen_speed * np.exp(line @ [1, *clues(far)]), rel=0.1)


def test_one_flame_is_enough_and_says_only_its_factor():
    axis = column()
    fitted = Pace.fit([axis], [3 * axis.seen_speed])
    assert fitted.of(axis) == pytest.approx(3 * axis.seen_speed, rel=1e-3)
    assert np.abs(fitted.metric[1:]).max() < 0.9


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_without_metres_the_unit_of_length_does_not_matter(size):
    pace = Pace(np.array([0.5, 0.8, -0.4]), np.array([0.5, 0.0, -0.4]))
    same = pace.of(column(), metres=False)
    assert pace.of(column(1.5 * size, 0.5 * size, 0.05 * size), metres=False) / size == pytest.approx(same, rel=1e-6)


def test_what_is_stranger_than_all_flames_counts_no_more_than_the_strangest():
    crawling = column(seen=1e-6)
    assert np.abs(clues(crawling)).max() <= FARTHEST
    assert np.isfinite(Pace(np.ones(3), np.ones(3)).of(crawling))
