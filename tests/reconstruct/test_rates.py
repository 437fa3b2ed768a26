"""Learning rates along a run, against their closed forms."""

from dataclasses import replace

import pytest

from gof.reconstruct.methods import OURS, PAPER
from gof.reconstruct.optimize import Schedule, Units

UNITS = Units(voxel_size=0.1, frame_time_s=0.01)


def test_rates_are_held_and_then_fall_to_a_tenth():
    schedule = Schedule(22_500, OURS.rates, gas_apart=True)
    first = schedule.raw_rates(UNITS)
    assert first["scale"] == OURS.rates.scale and first["velocity"] == pytest.approx(OURS.rates.velocity * 10)
    for step, share in ((1, 1.0), (2500, 1.0), (12_500, 0.1**0.5), (22_500, 0.1)):
        found = schedule.raw_rates(UNITS, step)
        assert {name: found[name] / first[name] for name in first if name != "x0"} == pytest.approx(
            dict.fromkeys(sorted(first.keys() - {"x0"}), share)
        )
    short = Schedule(2500, OURS.rates, gas_apart=True)
    color = short.raw_rates(UNITS, 1750)["color_logit"]  # a fourth of it is the step of a middle grey
    assert color / 4 == OURS.rates.color, "seven tenths of a short run have no fall"
    assert short.raw_rates(UNITS, 2125)["color_logit"] == pytest.approx(color * 0.1**0.5)
    assert replace(short, color_of_light=False).raw_rates(UNITS)["color"] == OURS.rates.color
    middle, last = (schedule.raw_rates(UNITS, step)["x0"] for step in (11_250, 22_500))
    assert first["x0"] == pytest.approx(0.1 * OURS.rates.position[0])
    assert last == pytest.approx(0.1 * OURS.rates.position[1])
    assert middle == pytest.approx((first["x0"] * last) ** 0.5)


def test_the_papers_rates_never_fall_but_the_positions():
    schedule = Schedule(30_000, PAPER.rates, gas_apart=False)
    first, last = schedule.raw_rates(UNITS), schedule.raw_rates(UNITS, 30_000)
    assert {name for name in first if first[name] != last[name]} == {"x0"}


def test_a_run_of_no_step_has_rates():
    assert all(rate >= 0 for rate in Schedule(0, OURS.rates, gas_apart=True).raw_rates(UNITS, 0).values())
