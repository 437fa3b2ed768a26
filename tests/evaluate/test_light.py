"""Light in space: closed forms of Gaussians against Gaussians, and what a smear along the view is."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.grid_writer import GridWriter, scalar
from gof.evaluate.emission import EXPONENT, FlameGrid
from gof.evaluate.light import score_light
from tests.evaluate.analytic import make_gaussians
from tests.evaluate.test_emission import CELLS, SIDE, TIMES, TO_WORLD, write_grid

FORWARD = np.array([0.0, 1.0, 0.0])
MIDDLE = np.array([0.0, 0.0, 1.75])
WIDTH = 0.35  # m, seven cells


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    """A round Gaussian of light, the same in both frames."""
    place = (np.stack(np.meshgrid(*[np.arange(CELLS)] * 3, indexing="ij"), -1) + 0.5) * SIDE + TO_WORLD[:3, 3]
    light = np.exp(-0.5 * ((place - MIDDLE) ** 2).sum(-1) / WIDTH**2)
    values = np.where(light > 1e-4, light, 0) ** (1 / EXPONENT)
    return FlameGrid(write_grid(tmp_path_factory.mktemp("light") / "flame.zarr", np.stack([values] * 2)))


def blob(scale=(WIDTH,) * 3, middle=MIDDLE, **changes):
    values = {"velocity": [[0, 0, 0]], "opacity": [0.5], "rotation": [[1, 0, 0, 0]]} | changes
    return make_gaussians(1, position=[middle], scale=[scale], **values)


def cloud(count=40000, width=WIDTH, size=0.03, seed=1):
    """The same light out of many small Gaussians."""
    place = np.random.default_rng(seed).normal(MIDDLE, np.sqrt(width**2 - size**2), (count, 3))
    return make_gaussians(
        count,
        position=place,
        velocity=np.zeros((count, 3)),
        scale=np.full((count, 3), size),
        opacity=np.full(count, 0.3),
        color=np.full((count, 3), 0.5),
    )


@pytest.mark.parametrize("result", [blob(), cloud()], ids=["one", "many"])
def test_the_same_light_is_the_truth(flame, result):
    found = score_light(result, flame, TIMES, FORWARD)
    assert found.correlation > 0.985
    assert found.relative_l2 < 0.18
    assert found.smear == pytest.approx(1, abs=0.03)
    assert found.outside < 0.03


@pytest.mark.parametrize("away", [0.2, 0.5])
def test_a_moved_flame_by_its_closed_form(flame, away):
    """Two equal round Gaussians d apart: cosine exp(-d^2 / 4 s^2), relative L2 sqrt(2 - 2 cosine)."""
    found = score_light(blob(middle=MIDDLE + [0, away, 0]), flame, TIMES, FORWARD)
    cosine = np.exp(-(away**2) / (4 * WIDTH**2))
    assert found.correlation == pytest.approx(cosine, abs=0.02)
    assert found.relative_l2 == pytest.approx(np.sqrt(2 - 2 * cosine), abs=0.03)


def test_what_is_drawn_out_along_the_view_is_a_smear(flame):
    along = score_light(blob(scale=(WIDTH, 1.4 * WIDTH, WIDTH)), flame, TIMES, FORWARD)
    assert along.smear == pytest.approx(1.4, rel=0.02)
    across = score_light(blob(scale=(1.4 * WIDTH, WIDTH, WIDTH)), flame, TIMES, FORWARD)
    assert across.smear == pytest.approx(1 / 1.4, rel=0.02)
    assert score_light(blob(), flame, TIMES, np.array([0, 0, -1.0])).smear is None


def test_light_beside_the_flame_is_outside(flame):
    """A quarter of the light stands 1.5 m, more than four widths, beside the flame."""
    many, few = cloud(3000), cloud(1000, seed=2)
    few = replace(few, position=few.position + np.array([1.5, 0, 0], np.float32))
    found = score_light(type(many).concatenate([many, few]), flame, TIMES, FORWARD)
    assert found.outside == pytest.approx(0.25, abs=0.03)


def test_only_what_shines_counts(flame):
    """Not what is invisible, black or still."""
    shining = cloud(2000)
    beside = np.array([1.5, 0, 0], np.float32)
    for useless in (
        replace(shining, opacity=np.full(2000, 0.003)),
        replace(shining, color=np.zeros((2000, 3))),
        replace(shining, dynamic=np.zeros(2000, bool)),
    ):
        moved = replace(useless, position=useless.position + beside)
        found = score_light(type(shining).concatenate([shining, moved]), flame, TIMES, FORWARD)
        assert found == score_light(shining, flame, TIMES, FORWARD)


def test_no_light_and_no_flame_at_all(flame, tmp_path):
    dark = score_light(blob(color=[[0, 0, 0]]), flame, TIMES, FORWARD)
    assert (dark.relative_l2, dark.correlation, dark.outside, dark.smear) == (1.0, 0.0, 0.0, None)
    nothing = FlameGrid(write_grid(tmp_path / "flame.zarr", np.zeros((2, CELLS, CELLS, CELLS))))
    assert score_light(blob(), nothing, TIMES, FORWARD) is None


def test_an_opaque_gaussian_is_finite(flame):
    assert np.isfinite(score_light(blob(opacity=[1.0]), flame, TIMES, FORWARD).relative_l2)


@pytest.mark.parametrize("cell", [(0.1, 0.05, 0.05), (0.05, 0.05, 0.1)])
def test_cells_need_not_be_cubes(tmp_path, cell):
    """A wide Gaussian against its own light in the cells: its density times their volume."""
    shape = tuple(round(2.8 / side) for side in cell)
    to_world = np.diag([*cell, 1.0])
    to_world[:3, 3] = MIDDLE - 1.4
    place = (np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1) + 0.5) * cell + to_world[:3, 3]
    light = np.exp(-0.5 * ((place - MIDDLE) ** 2).sum(-1) / WIDTH**2)
    light[light < 0.01] = 0
    facts = scalar("flame") | {"light_exponent": 1.0}
    writer = GridWriter(
        tmp_path / "flame.zarr", shape, to_world, TIMES, float(np.cbrt(np.prod(cell))), "float32", facts
    )
    for k in range(len(TIMES)):
        writer.write_frame(k, light.__getitem__)
    writer.finish()
    found = score_light(blob(), FlameGrid(tmp_path / "flame.zarr"), TIMES, FORWARD)
    assert found.relative_l2 < 0.06 and found.outside == pytest.approx(0, abs=0.03)
