"""The time that is said before it has passed, by a made-up clock."""

from dataclasses import replace

import pytest

from gof.core import time_left
from gof.core.time_left import MachineLoad, Paces, TimeLeft, duration
from gof.reconstruct import pipeline


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def run(left, clock, part, seconds, until=1.0, steps=20):
    """Let a part take so long, and return what was said to be left of everything after each step."""
    said = [left.reach(part, 0.0)]
    for k in range(1, steps + 1):
        clock.now_s += until * seconds / steps
        left.reach(part, until * k / steps)
        said.append(left.seconds)
    return said[1:]


def test_a_machine_half_as_fast_is_seen_before_a_tenth_is_done():
    clock = Clock()
    left = TimeLeft({"see": 20.0, "fit": 80.0}, clock)  # in truth 40 and 160
    said = run(left, clock, "see", 40.0, steps=40)
    assert left.expected_s == {"see": 20.0, "fit": 80.0}
    assert said[0] > 100, "the parts to come are as expected as long as no part is over"
    said = run(left, clock, "fit", 160.0, until=0.1)
    assert said[-1] == pytest.approx(144.0, rel=0.25)
    said = run(left, clock, "fit", 160.0)
    assert said[-2] == pytest.approx(8.0, rel=0.35) and said[-1] == 0


def test_parts_to_come_are_as_slow_as_those_that_are_over():
    clock = Clock()
    left = TimeLeft({"see": 50.0, "fit": 50.0}, clock)
    run(left, clock, "see", 150.0)
    left.end()
    assert left.took_s == {"see": 150.0}
    assert left.seconds == pytest.approx(50 * (10 + 150) / (10 + 50))  # three times slower, a tenth as expected


def test_what_was_done_by_an_earlier_run_says_nothing_of_the_pace():
    clock = Clock()
    left = TimeLeft(clock=clock)
    left.reach("fit", 0.5)
    assert left.seconds is None
    clock.now_s += 10
    left.reach("fit", 0.6)
    assert left.seconds == pytest.approx(40.0)
    clock.now_s += 15  # nothing is heard, and time goes on
    assert left.seconds == pytest.approx(25.0)


def test_earlier_work_of_the_kind_says_what_the_next_takes(tmp_path, monkeypatch):
    """A machine whose fits take three times the model's seconds, in a crowd that halves all cores."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    parts, crowd = {"fit": 10.0, "see": 4.0}, MachineLoad(1.0, 2.0)
    assert Paces.known().expected_s(parts, replace(crowd, slow=1.5)) == {"fit": 30.0, "see": 12.0}
    Paces.known().with_run("fit", 60.0 / 10.0 / crowd.crowded).keep()
    assert Paces.known().expected_s(parts, crowd) == pytest.approx({"fit": 60.0, "see": 8.0})
    Paces.known().with_run("fit", 12.0).keep()
    assert Paces.known().ratios["fit"] == pytest.approx(6.0)  # the middle of 3 and 12, in logarithms
    Paces.known().with_run("fit", float("nan")).keep()
    assert Paces.known().without("see").ratios.keys() == {"fit"}
    Paces.path().write_text("{")
    assert Paces.known().ratios == {}
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc")
    Paces({"fit": 1.0}).keep()


@pytest.mark.parametrize(("crowded", "learned"), [(1.1, {"fit": 3.0}), (4.0, {})])
def test_of_a_crowded_run_nothing_is_learned(tmp_path, monkeypatch, crowded, learned):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, machine = Clock(), MachineLoad(1.0, crowded)
    left = TimeLeft({"fit": 10.0}, clock)
    run(left, clock, "fit", 30.0 * crowded)
    monkeypatch.setattr(MachineLoad, "measured_now", lambda: machine)
    pipeline._learn({"fit": 10.0}, left, machine)
    assert Paces.known().ratios == pytest.approx(learned)


def test_a_probe_tells_slow_cores_from_a_crowd(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(time_left.time, "perf_counter", clock)

    def probe(rounds):
        clock.now_s += 0 if rounds == 1 else 4 * time_left.PROBE_S / cores
        return 2 * time_left.PROBE_S

    cores = len(time_left.os.sched_getaffinity(0))
    monkeypatch.setattr(time_left, "_probe", probe)
    now = MachineLoad.measured_now()
    assert now.slow == pytest.approx(2.0) and now.crowded == pytest.approx(2.0, rel=0.3)


def test_seconds_in_words():
    assert [duration(s) for s in (4.4, 89, 100, 5000, 7200)] == ["4 s", "89 s", "2 min", "83 min", "2.0 h"]
