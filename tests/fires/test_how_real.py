"""Measures of a fire on fields and pictures whose answer is known, and what the command says of them."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.fields import VelocityField
from gof.dataset import Dataset, DatasetDescription
from gof.look.drawing import COLOURS
from gof_benchmark.fires import how_real
from gof_benchmark.fires.flames import flame_of
from gof_benchmark.fires.measures import (
    ZONES,
    axis_columns,
    flame_height,
    flicker,
    heat_release_kw,
    heskestad_heat,
    heskestad_height,
    light_speed,
    mccaffrey_speed,
    mean_over_time,
    power_law,
    puffing_frequency,
    puffing_law,
    rise_speed,
    spectrum,
)
from gof_blender.pure.fires import Fire
from gof_blender.pure.spec import SceneSpec
from tests.conftest import arc, write_dataset
from tests.look.printed import curves, texts
from tests.solvers.conftest import write_small_fire

CAPTURES = Path(os.environ.get("GOF_CAPTURES", Path(__file__).parents[3] / "shared" / "captures"))


# ---------------------------------------------------------------- laws


def test_mccaffreys_zones_meet_and_do_not_depend_on_heat_in_the_flame():
    z = np.array([0.05, 0.1, 0.2])
    np.testing.assert_allclose(mccaffrey_speed(z, 30), 6.8 * np.sqrt(z), rtol=1e-12)
    np.testing.assert_allclose(mccaffrey_speed(z, 60), mccaffrey_speed(z, 30), rtol=1e-12)
    for limit, _, _ in ZONES[:2]:  # his fits meet within some per cent
        edge = limit * 33**0.4
        below, above = mccaffrey_speed([edge * (1 - 1e-6), edge * (1 + 1e-6)], 33)
        assert below == pytest.approx(above, rel=0.05)
    assert mccaffrey_speed([0.5], 33)[0] == pytest.approx(1.9 * 33**0.2)


def test_heskestads_and_cetegens_figures():
    assert heskestad_height(81, 0.26) == pytest.approx(1.10, abs=0.02)
    assert heskestad_height(0.1, 1.0) == 0
    assert heskestad_heat(1.10, 0.26) == pytest.approx(81, rel=0.02)
    assert puffing_law(0.2257) == pytest.approx(3.16, abs=0.01)


# ---------------------------------------------------------------- measures


def test_power_law_is_exact_on_a_power_law():
    z = np.linspace(0.02, 0.4, 20)
    assert power_law(z, 6.8 * z**0.5) == pytest.approx((6.8, 0.5))
    assert np.isnan(power_law(z, -z)).all()


def test_a_mean_over_an_uneven_clock_counts_time_not_samples():
    t = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    np.testing.assert_allclose(mean_over_time(t, np.stack([2 * t, np.full(5, 3.0)], 1)), [1.0, 3.0])
    assert (2 * t).mean() != pytest.approx(1.0, rel=0.05), "the comparison would show nothing"


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


def test_a_spectrums_integral_is_the_variance():
    t = np.arange(400) * 0.0025
    frequency, power = spectrum(t, 5.0 + 0.7 * t + 0.3 * np.sin(2 * np.pi * 20 * t))
    assert power.sum() * frequency[1] == pytest.approx(0.3**2 / 2, rel=0.01)
    assert frequency[np.argmax(power)] == pytest.approx(20, abs=0.2)


def test_flicker_is_the_share_of_light_that_swings_between_15_and_40_hz():
    t = np.arange(100) / 400
    light = 250 * (1 + 0.03 * np.sin(2 * np.pi * 27 * t) + 0.5 * t)
    assert flicker(t, light)[0] == pytest.approx(0.03 / np.sqrt(2) / (1 + 0.5 * t.mean()), rel=0.02)
    slow = 1 + 0.3 * np.sin(2 * np.pi * 0.8 * np.arange(400) / 400)  # a puff, no flicker
    assert flicker(np.arange(400) / 400, slow)[0] < 0.001
    puff = 1 + 0.9 * np.sin(2 * np.pi * 3.5 * np.arange(36) / 120)  # one, and hardly that, in the clip
    assert flicker(np.arange(36) / 120, puff)[0] < 0.01
    rng = np.random.default_rng(1)
    noise = 1 + 0.01 * rng.normal(size=40_000)  # white
    assert flicker(np.arange(40_000) / 400, noise)[1] == pytest.approx(0, abs=0.1)


def test_no_flicker_from_slow_or_short_clips():
    assert np.isnan(flicker(np.arange(60) / 60, np.random.default_rng(0).random(60) + 1)).all()
    assert np.isnan(flicker(np.arange(48) / 400, np.random.default_rng(0).random(48) + 1)).all()


def rising_light(time_s, height, speed, seed=0, fading=0.6):
    """Bright structures a twentieth of the height in size that rise with a speed, in a flame that is darker above."""
    pattern = np.random.default_rng(seed).normal(size=400)
    pattern = np.convolve(pattern, np.hanning(9), "same")
    place = np.linspace(-3, 2, 400) * height[-1]
    light = 1 + 0.2 * np.array([np.interp(height - speed * t, place, pattern) for t in time_s])
    return light * (1 - fading * height / height[-1])


@pytest.mark.parametrize("speed, rate, step", [(1.5, 100, 0.01), (3.0, 100, 0.01), (2.2, 400, 0.004), (600, 400, 1.0)])
def test_rise_speed_of_structures(speed, rate, step):
    time_s, height = np.arange(36) / rate, step * (np.arange(150) + 0.5)
    band = (0.2 * height[-1], 0.6 * height[-1])
    assert rise_speed(time_s, height, rising_light(time_s, height, speed), band) == pytest.approx(speed, rel=0.03)


def test_rise_speed_says_nothing_of_noise_of_still_light_or_of_what_falls():
    time_s, height = np.arange(36) / 100, 0.01 * (np.arange(150) + 0.5)
    noise = 1 + 0.2 * np.random.default_rng(0).random((36, 150))
    still = np.broadcast_to(1 + np.sin(20 * height), (36, 150))
    for light in (noise, still, rising_light(time_s, height, -2.0)):
        assert np.isnan(rise_speed(time_s, height, light, (0.3, 0.9)))


def test_flame_height_is_where_it_stands_half_of_the_time():
    z = 0.05 * (np.arange(20) + 0.5)
    brightest = np.array([[1.0] * top + [0.0] * (20 - top) for top in (4, 8, 8, 12)])  # 8 in three frames of four
    assert flame_height(brightest, z) == pytest.approx(0.4)
    assert flame_height(np.zeros((1, 20)), z) == 0


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


def test_the_axis_between_cells_is_the_four_columns_around_it():
    x = 0.05 * (np.arange(6) - 2.5)
    a, b = axis_columns(x, x, (0.0, 0.0), 0.2)
    assert set(a) | set(b) == {2, 3} and len(a) == 4


# ---------------------------------------------------------------- fires


def test_a_fire_that_obeys_the_laws_is_said_to(tmp_path):
    write_small_fire(tmp_path / "fire")
    flame = flame_of(tmp_path / "fire")
    looks = how_real.seen(flame)
    figures = how_real.laws(flame.truth, looks.height)
    assert looks.height == pytest.approx(0.3) and flame.truth.heat_burnt_kw == pytest.approx(30)
    assert figures.heat_kw == 30 and not figures.heat_inferred
    assert figures.shining_ratio == pytest.approx(1) and figures.shining_exponent == pytest.approx(0.5)
    assert figures.puffing_hz == pytest.approx(3.2, abs=0.2)


def test_the_history_says_the_speed_as_far_as_it_reaches(tmp_path):
    """Its one probe at 0.1 m swings about 0.015 m/s for a second; the clip above it obeys McCaffrey."""
    write_small_fire(tmp_path / "fire")
    axis = flame_of(tmp_path / "fire").truth.axis
    assert axis.over_s == pytest.approx(1.296) and axis.height_m[0] == 0.1
    assert abs(axis.speed_m_s[0]) < 0.1, "not 2.15 as in the clip"
    np.testing.assert_allclose(axis.speed_m_s[1:], 6.8 * np.sqrt(axis.height_m[1:]), rtol=1e-6)
    (tmp_path / "fire/history.json").unlink()
    axis = flame_of(tmp_path / "fire").truth.axis
    assert axis.over_s == pytest.approx(0.02)
    np.testing.assert_allclose(axis.speed_m_s, 6.8 * np.sqrt(axis.height_m), rtol=1e-6)
    figures = how_real.laws(flame_of(tmp_path / "fire").truth, 0.3)
    assert figures.rise_ratio == pytest.approx(1) and figures.rise_exponent == pytest.approx(0.5)
    assert np.isnan(figures.puffing_hz), "three frames are no record"


BASE_M, FLAME_M = 0.4, (0.0, 0.7)  # where the burner ends, and the flame above it


def write_flame_pictures(folder, frames=36) -> Path:
    """A dataset of a disc burner whose light fills the axis above it, seen by two cameras of its height."""
    import OpenEXR

    cameras = arc(2, width=90, height=160, focal_px=200.0)
    times = np.arange(frames) / 100
    blank = np.zeros((frames, 2, 160, 90, 3))
    z = 0.05 * (np.arange(40) + 0.5)
    field = np.zeros((9, 9, 40, 3))
    field[..., 2] = 6.8 * np.sqrt(np.maximum(z - BASE_M, 0))
    fields = [VelocityField.from_array(field, (-0.225, -0.225, 0.0), 0.05, float(t)) for t in times]
    write_dataset(folder, cameras, blank, blank[0], times, fields)
    fire = Fire("wood", "disc", (0.0, 0.0, BASE_M - 0.02), 0.12)
    spec = SceneSpec("flame", fire=fire).to_dict()
    description = DatasetDescription.read(folder)
    named = tuple(replace(entry, exr=f"{entry.name}_{{frame}}.exr") for entry in description.cameras)
    replace(description, cameras=named, spec=spec).write(folder)
    height = 1 + 3 * (79.5 - np.arange(160)) / 200 - BASE_M  # above the burner, of the axis that a row shows
    light = rising_light(times, np.linspace(0, 1, 71), 2.0)
    for entry in description.cameras:
        for k in range(frames):
            red = np.zeros((160, 90), np.float32)
            rows = (height > FLAME_M[0]) & (height < FLAME_M[1])
            red[rows, 40:50] = np.interp(height[rows], np.linspace(0, 1, 71), light[k])[:, None]
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, {"flame.R": red}).write(str(folder / f"{entry.name}_{k}.exr"))
    return folder


def test_a_simulated_fire_is_measured_on_its_velocity_and_its_pictures(tmp_path):
    flame = flame_of(write_flame_pictures(tmp_path / "dev" / "flame"))
    looks = how_real.seen(flame)
    figures = how_real.laws(flame.truth, looks.height)
    assert (flame.name, flame.source, len(flame.views)) == ("dev/flame", "Mantaflow", 2)
    assert looks.height == pytest.approx(0.7, abs=0.02)
    # Heskestad's law solved for Q at 0.7 m and 0.24 m.
    assert figures.heat_inferred and figures.heat_kw == pytest.approx(((0.7 + 0.2448) / 0.235) ** 2.5, rel=0.06)
    assert figures.rise_ratio == pytest.approx(1, rel=0.01) and figures.rise_exponent == pytest.approx(0.5, abs=0.01)
    assert looks.rise[1] == pytest.approx(2.0 / 0.7, rel=0.05)
    assert np.isnan(figures.puffing_hz) and np.isnan(figures.height_law_m)


def test_a_fire_in_wind_is_not_held_beside_the_laws_of_still_air(tmp_path):
    write_small_fire(tmp_path / "fire", wind_m_s=(0.0, 1.0))
    flame = flame_of(tmp_path / "fire")
    row = how_real.laws_row(flame, how_real.seen(flame))
    assert row[:1] + row[3:] == ("small (wind)", "-", "-", "-", "-", "0.30", "wind (3.4)")  # 1.5 / sqrt(0.2) = 3.35
    assert np.isnan(how_real.seen(flame).over_gas)


def test_a_dataset_that_nobody_generated_is_refused(tiny_dataset):
    with pytest.raises(DataFormatError, match="not a generated dataset"):
        flame_of(tiny_dataset)


def write_clip(path, speed_px, frames=40):
    """An orange flame 60 px high over a dark ground, with structures that rise, and a blinking board beside it."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 30, (96, 128))
    light = rising_light(np.arange(frames), np.arange(60.0), speed_px, fading=0.0)
    for k in range(frames):
        picture = np.full((128, 96, 3), 30, np.uint8)
        if k % 10:  # now and then there is no fire: the plate
            flame = np.clip(160 * light[k][::-1], 0, 255)[:, None] * np.ones(24)
            picture[40:100, 30:54] = np.stack([0.1 * flame, 0.5 * flame, flame], -1).astype(np.uint8)
        picture[110:116, 80:90] = 255 if k % 2 else 30
        writer.write(picture)
    writer.release()


def test_a_filmed_fire_is_measured_without_its_board(tmp_path):
    folder = tmp_path / "capture" / "clip"
    folder.mkdir(parents=True)
    write_clip(folder / "cam_0.mp4", 3.0)
    flame = flame_of(folder, 400.0)
    assert (flame.name, flame.source, flame.truth, flame.cut) == ("capture/clip", "real", None, False)
    (view,) = flame.views
    assert len(view.height) == pytest.approx(60, abs=8), "the flame's rows, not the board's"
    assert flame.time_s[-1] == pytest.approx(39 / 400)
    with pytest.raises(DataFormatError, match="--clip-rate-hz"):
        flame_of(folder)


# ---------------------------------------------------------------- the command


def test_the_command_prints_a_line_a_fire_and_draws(tmp_path, capsys):
    write_small_fire(tmp_path / "openfoam/small/grids")
    write_flame_pictures(tmp_path / "dev" / "flame")
    assert how_real.main([str(tmp_path), "--charts", str(tmp_path / "charts")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("| small |") for line in lines) == 3
    assert sum(line.startswith("| dev/flame |") for line in lines) == 2
    assert any("| small | 30.0 / 30.0 | 1.00 | 0.50 |" in line for line in lines)
    drawn = {path.name: path.read_text() for path in (tmp_path / "charts").iterdir()}
    assert set(drawn) == {"how_real_test.svg", "how_real_mantaflow.svg", "how_real_flicker.svg"}
    said = texts(drawn["how_real_mantaflow.svg"])
    assert {"dev/flame", "McCaffrey's law", "speed / Q^(1/5), m/s/kW^(1/5)"} <= set(said)
    assert len(curves(drawn["how_real_mantaflow.svg"], COLOURS[0])) == 1, "the law"


def test_a_dataset_of_grids_is_its_grids_and_not_counted_twice(tmp_path):
    write_small_fire(tmp_path / "openfoam/small/grids")
    folder = write_flame_pictures(tmp_path / "dev" / "burnt", frames=3)
    description = DatasetDescription.read(folder)
    grids = str(tmp_path / "openfoam/small/grids")
    spec = description.spec | {"fire": {"grids": grids}, "domain": None}
    replace(description, spec=spec).write(folder)
    assert flame_of(folder).name == "small"
    assert how_real.places_in(tmp_path) == [tmp_path / "openfoam/small/grids"]
    assert Dataset.open(folder).description.spec["fire"] == {"grids": grids}


def test_the_command_names_what_is_wrong(tmp_path, capsys):
    assert how_real.main([str(tmp_path / "none")]) == 1
    assert "no fire there" in capsys.readouterr().err
    write_small_fire(tmp_path / "b", hearths=())
    assert how_real.main([str(tmp_path / "b")]) == 1
    assert "no hearth" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(not CAPTURES.exists(), reason="the paper's clips are not part of this repository")
@pytest.mark.parametrize("clip, cut", [("capture_05/scene_0006", False), ("capture_04/scene_0009", True)])
def test_real_clips(clip, cut):
    """What a person sees in them: a flame that rises ever faster; in the second it leaves the picture."""
    flame = flame_of(CAPTURES / clip, 400.0)
    looks = how_real.seen(flame)
    assert len(flame.views) == 3 and len(flame.time_s) == 100 and flame.cut == cut
    assert 60 < looks.height < 480 and 0 < looks.rise[0] < looks.rise[2]
    assert 0.005 < looks.flicker < 0.3
