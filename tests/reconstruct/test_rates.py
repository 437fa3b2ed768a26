"""Learning rates along a run, against their closed forms."""

import pytest

from gof.reconstruct.methods import OURS, PAPER
from gof.reconstruct.optimize import Schedule, Units

UNITS = Units(voxel_size=0.1, frame_time_s=0.01)


def test_rates_are_held_and_then_fall_as_one_over_the_step():
    """So however long a run, the first steps are those of a short one."""
    schedule = Schedule(20_000, OURS.rates, gas_apart=True)
    first = schedule.raw_rates(UNITS)
    assert first["scale"] == OURS.rates.scale and first["velocity"] == pytest.approx(OURS.rates.velocity * 10)
    for step, share in ((1, 1.0), (2500, 1.0), (5000, 0.5), (20_000, 0.125)):
        found = schedule.raw_rates(UNITS, step)
        assert {name: found[name] / first[name] for name in first if name != "x0"} == pytest.approx(
            dict.fromkeys(sorted(first.keys() - {"x0"}), share)
        )
    middle, last = (schedule.raw_rates(UNITS, step)["x0"] for step in (10_000, 20_000))
    assert first["x0"] == pytest.approx(0.003) and last == pytest.approx(0.0003)
    assert middle == pytest.approx((first["x0"] * last) ** 0.5)


def test_the_papers_rates_never_fall_but_the_positions():
    schedule = Schedule(30_000, PAPER.rates, gas_apart=False)
    first, last = schedule.raw_rates(UNITS), schedule.raw_rates(UNITS, 30_000)
    assert {name for name in first if first[name] != last[name]} == {"x0"}


def test_a_run_of_no_step_has_rates():
    assert all(rate >= 0 for rate in Schedule(0, OURS.rates, gas_apart=True).raw_rates(UNITS, 0).values())
