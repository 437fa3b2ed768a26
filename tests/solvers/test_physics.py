"""The checks of a fire's truth on fields whose answer is known."""

import json

import numpy as np
import pytest

from gof_benchmark.solvers import how_real
from gof_benchmark.solvers.grids import FireGrids
from gof_benchmark.solvers.physics import (
    ZONES,
    axis_columns,
    flame_height,
    heat_release_kw,
    heskestad_height,
    light_speed,
    mccaffrey_excess,
    mccaffrey_speed,
    plausibility,
    power_law,
    puffing_frequency,
    puffing_law,
)
from tests.solvers.conftest import write_small_fire


def test_mccaffreys_zones_meet_and_do_not_depend_on_heat_in_the_flame():
    z = np.array([0.05, 0.1, 0.2])
    np.testing.assert_allclose(mccaffrey_speed(z, 30), 6.8 * np.sqrt(z), rtol=1e-12)
    np.testing.assert_allclose(mccaffrey_speed(z, 60), mccaffrey_speed(z, 30), rtol=1e-12)
    for limit, _, _ in ZONES[:2]:  # his fits meet within some per cent
        edge = limit * 33**0.4
        below, above = mccaffrey_speed([edge * (1 - 1e-6), edge * (1 + 1e-6)], 33)
        assert below == pytest.approx(above, rel=0.05)
    assert mccaffrey_speed([0.5], 33)[0] == pytest.approx(1.9 * 33**0.2)
    # About 800 K above ambient in the continuous flame, as he measured.
    assert mccaffrey_excess([0.1], 33)[0] == pytest.approx(850, rel=0.1)


def test_heskestads_and_cetegens_figures():
    assert heskestad_height(81, 0.26) == pytest.approx(1.10, abs=0.02)
    assert heskestad_height(0.1, 1.0) == 0
    assert puffing_law(0.2257) == pytest.approx(3.16, abs=0.01)


def test_power_law_is_exact_on_a_power_law():
    z = np.linspace(0.02, 0.4, 20)
    assert power_law(z, 6.8 * z**0.5) == pytest.approx((6.8, 0.5))
    assert np.isnan(power_law(z, -z)).all()


@pytest.mark.parametrize("hz", [2.0, 3.16, 7.0])
def test_puffing_frequency_of_swings_on_uneven_steps(hz):
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.001, 0.004, 800))  # 2 s
    phases = rng.uniform(0, 6, 4)
    signals = np.stack([np.sin(2 * np.pi * hz * t + p) for p in phases], 1)
    signals += 0.3 * rng.normal(size=signals.shape) + 0.5 * t[:, None]
    assert puffing_frequency(t, signals) == pytest.approx(hz, abs=0.15)


def test_no_frequency_without_a_record():
    assert np.isnan(puffing_frequency(np.array([0.0, 0.1]), np.zeros((2, 1))))
    assert np.isnan(puffing_frequency(np.arange(100) * 0.01, np.zeros((100, 1))))


def test_flame_height_is_where_it_stands_half_of_the_time():
    z = 0.05 * (np.arange(20) + 0.5)
    light = []
    for top in (4, 8, 8, 12):  # cells lit; at least 8 in three frames of four
        e = np.zeros((3, 3, 20))
        e[1, 1, :top] = 1.0
        light.append(e)
    assert flame_height(light, z) == pytest.approx(0.4)
    assert flame_height([np.zeros((3, 3, 20))], z) == 0


def test_light_speed_is_of_the_shining_gas_only():
    v = np.zeros((2, 1, 3, 3))
    v[0, 0, :, 2], v[1, 0, :, 2] = 4.0, 1.0
    e = np.zeros((2, 1, 3))
    e[0, 0, :2] = 1.0
    e[1, 0, 1] = 1.0
    speed = light_speed([v], [e])
    assert speed[:2] == pytest.approx([4.0, 2.5]) and np.isnan(speed[2])


def test_heat_is_summed_over_the_volume():
    assert heat_release_kw(np.full((10, 10, 10), 5e5), 0.1) == pytest.approx(500)


def test_a_fire_that_obeys_the_laws_is_said_to(tmp_path):
    fire = write_small_fire(tmp_path / "fire")
    figures = plausibility(fire)
    assert figures.rise_ratio == pytest.approx(1) and figures.rise_exponent == pytest.approx(0.5)
    assert figures.light_ratio == pytest.approx(1) and figures.heat_kw == pytest.approx(30)
    assert figures.height_m == pytest.approx(0.3) and figures.puffing_hz == pytest.approx(3.2, abs=0.2)
    x, y = axis_columns(fire, fire.description.hearths[0])
    assert set(x) | set(y) == {2, 3}  # the four columns around an axis that lies between cells


def test_the_command_prints_and_writes(tmp_path, capsys):
    write_small_fire(tmp_path / "a")
    assert how_real.main([str(tmp_path / "a"), "--json", str(tmp_path / "t.json")]) == 0
    assert "small | 30.0 / 30.0 | 1.00 | 0.50" in capsys.readouterr().out
    assert json.loads((tmp_path / "t.json").read_text())["fires"][0]["rise_ratio"] == pytest.approx(1)


def test_the_command_names_what_is_wrong(tmp_path, capsys):
    assert how_real.main([str(tmp_path / "none")]) == 1
    assert "fire.json" in capsys.readouterr().err
    write_small_fire(tmp_path / "b", hearths=())
    assert how_real.main([str(tmp_path / "b")]) == 1
    assert "no hearth" in capsys.readouterr().err
    assert FireGrids.open(tmp_path / "b").description.hearths == ()
