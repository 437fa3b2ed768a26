"""The factory's fires: their gas against its own budgets and the textbook, their pictures against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from gof_benchmark.training.factory.draws import KINDS, Draw
from gof_benchmark.training.factory.light import LAWS, emission
from gof_benchmark.training.factory.pictures import around, developed, gathered
from gof_benchmark.training.factory.solver import (
    AMBIENT_DENSITY,
    AMBIENT_K,
    HEAT_CAPACITY,
    Box,
    Burner,
    Chemistry,
    Gas,
    Poisson,
)


def pool(diameter_m: float, power_w: float, cells: tuple[int, int, int], across: int) -> Gas:
    """A round burner in the middle of the floor, `across` cells wide, in open air."""
    cell = diameter_m / across
    box = Box(cells, cell, (-cells[0] * cell / 2, -cells[1] * cell / 2, 0.0))
    x, y, z = box.centres()
    where = (np.hypot(x, y) < diameter_m / 2) & (z < cell)
    return Gas(box, (Burner((where / where.sum()).astype(np.float32), power_w),))


@pytest.fixture(scope="module")
def small() -> Gas:
    """A small pool fire after 0.4 s."""
    gas = pool(0.2, 12e3, (14, 14, 18), 5)
    gas.run_to(0.4)
    return gas


def test_mass_mixture_and_fuel_balance(small):
    """What came in, less what left and burnt, is there."""
    volume, budget = small.box.cell**3, small.budget

    def held(share: np.ndarray | float) -> float:
        return float((small.density * share).sum(dtype=np.float64)) * volume

    assert budget.fed == pytest.approx(12e3 / 44e6 * 0.4, rel=1e-4)
    assert budget.burnt > 0.3 * budget.fed
    air_at_start = AMBIENT_DENSITY * small.density.size * volume
    assert held(1.0) - air_at_start == pytest.approx(budget.fed - budget.mass_out, abs=1e-5 * air_at_start)
    assert held(small.mixture) == pytest.approx(budget.fed - budget.mixture_out, rel=1e-3)
    assert held(small.fuel) == pytest.approx(budget.fed - budget.fuel_out - budget.burnt, abs=1e-3 * budget.fed)


def test_heat_leaves_as_volume(small):
    """At one pressure, gas that takes heat pushes out its share of volume: q / (density x heat capacity x K)."""
    faces = small.u, small.v, small.w
    area = small.box.cell**2
    out = 0.0
    for axis, a in enumerate(faces):
        ends = np.moveaxis(a, axis, 0).astype(np.float64)
        out += (ends[-1].sum() - ends[0].sum()) * area
    heat = float(small.heat.sum(dtype=np.float64)) * small.box.cell**3
    warming = (1 - small.chemistry.radiated) * heat
    fed = 12e3 / 44e6 / AMBIENT_DENSITY
    expected = warming / (AMBIENT_DENSITY * AMBIENT_K * HEAT_CAPACITY) + fed
    assert 4e3 < heat < 36e3
    assert out == pytest.approx(expected, rel=0.01)


def test_gas_is_no_hotter_than_it_may_be_and_nothing_is_negative(small):
    assert small.temperature.max() < 2600
    assert small.temperature.min() > AMBIENT_K - 1
    assert min(small.fuel.min(), small.soot.min()) >= 0
    assert small.mixture.max() <= 1.001


def test_still_air_stays_still():
    gas = pool(0.2, 0.0, (8, 8, 8), 4)
    gas.run_to(0.1)
    assert max(abs(gas.u).max(), abs(gas.v).max(), abs(gas.w).max()) == 0
    assert (gas.density == np.float32(AMBIENT_DENSITY)).all()


@pytest.mark.parametrize("ends", [(True, True), (False, False), (False, True), (True, False)])
def test_pressure_solves_its_equation(ends):
    rng = np.random.default_rng(0)
    right = rng.normal(size=(6, 5, 4)).astype(np.float32)
    sides = (ends, (True, True), (False, True))
    p = Poisson(sides, right.shape)(right)
    total = np.zeros_like(p)
    for axis, (low, high) in enumerate(sides):
        moved = np.moveaxis(p, axis, 0)
        beyond_low = -moved[:1] if low else moved[:1]
        beyond_high = -moved[-1:] if high else moved[-1:]
        total += np.moveaxis(np.diff(np.concatenate([beyond_low, moved, beyond_high]), 2, axis=0), 0, axis)
    np.testing.assert_allclose(total, right, atol=1e-4)


def test_a_bubble_of_mixture_is_carried_at_the_speed_of_the_air():
    """Wind of 1 m/s along X and no fire: the middle of a smooth bubble moves 0.1 m in 0.1 s and keeps its mass."""
    cells, cell = (24, 8, 8), 0.02
    wind = (np.ones((25, 8, 8)), np.zeros((24, 9, 8)), np.zeros((24, 8, 9)))
    gas = Gas(Box(cells, cell), (), start=wind)
    x, y, z = gas.box.centres()
    gas.mixture = np.exp(-((x - 0.15) ** 2 + (y - 0.08) ** 2 + (z - 0.08) ** 2) / 0.04**2).astype(np.float32)
    before, peak = float(gas.mixture.sum()), float(gas.mixture.max())
    gas.run_to(0.1)
    assert float((gas.mixture * x).sum() / gas.mixture.sum()) == pytest.approx(0.25, abs=0.002)
    assert float(gas.mixture.sum()) == pytest.approx(before, rel=0.01)
    assert gas.mixture.max() > 0.78 * peak, "a first-order scheme keeps 0.73 of it"


def test_a_law_shines_where_it_should(small):
    """Burning even where the gas is still cold; what glows is hot, and soot is where the gas is rich."""
    cold = small.temperature < 400
    for law in LAWS:
        light = emission(small, law)
        assert light.shape == small.density.shape and light.min() >= 0 and light.max() > 0, law
        assert law == "reaction" or light[cold].sum() < 0.02 * light.sum(), law
    rich = emission(small, "algebraic_soot")
    assert (small.mixture[rich > 0] > 0.7 * small.chemistry.stoichiometric).all()


def ball(cells: int = 24, cell: float = 0.05, radius: float = 0.35) -> tuple[np.ndarray, np.ndarray]:
    """A ball of light 1 in the middle of a box about zero, one frame."""
    matrix = np.diag([cell, cell, cell, 1.0])
    matrix[:3, 3] = -cells * cell / 2
    axis = (np.arange(cells) + 0.5) * cell + matrix[0, 3]
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)
    return np.clip((radius - distance) / cell + 0.5, 0, 1)[None].astype(np.float32), matrix


def middle_of(picture: np.ndarray) -> float:
    h, w = picture.shape
    return float(picture[h // 2 - 1 : h // 2 + 1, w // 2 - 1 : w // 2 + 1].mean())


def test_a_ray_gathers_the_light_along_it_and_no_more_than_is_not_hidden():
    """Through the middle: emission x chord; with absorption a, (1 - exp(-a chord)) / a. From any side."""
    light, matrix = ball()
    cameras = around(np.full(3, -0.6), np.full(3, 0.6), np.array([10.0, 100]), np.array([0.0, 20]), 2.0, 60)
    for camera in cameras:
        assert middle_of(gathered(camera, light, matrix)[0]) == pytest.approx(0.7, rel=0.03)
        hidden = gathered(camera, light, matrix, absorption=3.0)[0]
        assert middle_of(hidden) == pytest.approx((1 - np.exp(-2.1)) / 3, rel=0.03)


def test_light_is_seen_where_the_camera_projects_it():
    """A single bright cell off the middle; the picture's brightest pixels are about its projection."""
    light = np.zeros((2, 12, 12, 12), np.float32)
    light[1, 9, 3, 8] = 1
    matrix = np.diag([0.1, 0.1, 0.1, 1.0])
    centre = np.array([[0.95, 0.35, 0.85]])
    for camera in around(np.zeros(3), np.full(3, 1.2), np.array([-30.0, 70]), np.array([5.0, 25]), 1.5, 80):
        dark, seen = gathered(camera, light, matrix)
        assert dark.max() == 0
        row, column = np.unravel_index(seen.argmax(), seen.shape)
        pixel, _ = camera.project(centre)
        assert np.linalg.norm(pixel[0] - [column + 0.5, row + 0.5]) < 2


def test_cameras_hold_the_whole_box():
    low, high = np.array([-0.2, -0.3, 0.0]), np.array([0.2, 0.1, 1.0])
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    for camera in around(low, high, np.array([0.0, 50, 200]), np.array([-5.0, 10, 28]), 1.4, 200):
        pixels, depth = camera.project(corners)
        assert (depth > 0).all() and (pixels > 0).all() and (pixels < [camera.width, camera.height]).all()


def test_developed_pictures_are_eight_bits_and_dark_light_keeps_its_value():
    light = np.linspace(0, 3, 12).reshape(1, 3, 4)
    picture = next(developed(light, np.ones(3), np.zeros((3, 4, 3)), 0.0, np.random.default_rng(0)))
    np.testing.assert_allclose(picture * 255, np.rint(picture * 255), atol=1e-4)
    assert picture.max() <= 1 and (np.diff(picture[..., 0].ravel()) >= 0).all()
    assert picture[0, 2, 0] == pytest.approx(1.055 * (6 / 11) ** (1 / 2.4) - 0.055, abs=0.003)


@pytest.mark.parametrize("number", range(len(KINDS)))
def test_every_kind_can_be_drawn_and_again_the_same(number):
    draw, again = Draw.of(number), Draw.of(number)
    assert draw.kind == KINDS[number]
    assert draw.gas.box == again.gas.box and draw.rate_hz == again.rate_hz
    assert 25 <= draw.rate_hz <= 400 and 1 <= len(draw.azimuth_deg) <= 6
    for burner in draw.gas.burners:
        assert burner.share.sum() == pytest.approx(1, rel=1e-4)
        assert np.min(burner.supply(0.3)) >= 0


def test_kinds_meet_every_law():
    met = {(draw.kind, draw.law) for draw in map(Draw.of, range(4 * len(KINDS)))}
    assert len(met) == len(KINDS) * len(LAWS)


def test_chemistry_of_a_diluted_fuel():
    """Half strength: half the air, half the heat, and a richer mixture where they balance."""
    half, whole = Chemistry(strength=0.5), Chemistry()
    assert half.air_per_fuel == whole.air_per_fuel / 2 == 7.5
    assert half.fuel_heat == 22e6
    assert half.stoichiometric == pytest.approx(1 / 8.5)
    assert replace(half, strength=1.0) == whole
