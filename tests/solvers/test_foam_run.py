"""Baking: what a kill leaves behind, and going on after it."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError
from gof.core.records import write_record
from gof_benchmark.solvers.grids import FireGrids
from gof_benchmark.solvers.openfoam import run
from gof_benchmark.solvers.openfoam.case import write_case
from gof_benchmark.solvers.openfoam.fields import history_of
from tests.solvers.conftest import toy_fire

WHOLE = b"values\n// ************ //\n"


def write_time(case, name, without=(), torn=()):
    folder = case / name
    folder.mkdir(parents=True)
    for field in {"U", "T", "p", "p_rgh", "k", "nut", "alphat", "Qdot", "O2", "H2O", "CH4", "CO2", "N2"} - set(without):
        (folder / field).write_bytes(b"values\n" if field in torn else WHOLE)


def test_torn_times_are_dropped_and_whole_ones_stay(tmp_path):
    write_time(tmp_path, "0.1")
    write_time(tmp_path, "0.2")
    write_time(tmp_path, "0.25", torn=("T",))
    write_time(tmp_path, "1e-05", torn=("T",))
    write_time(tmp_path, "0.3", without=("CO2",))
    run.drop_torn_times(toy_fire(), tmp_path)
    assert run.times_of(tmp_path) == ["1e-05", "0.1", "0.2"]


def test_cpu_seconds_add_up_over_killed_runs(tmp_path):
    lines = ["ExecutionTime = 1.5 s  ClockTime = 2 s", "ExecutionTime = 4 s  ClockTime = 5 s", "ExecutionTime = 2 s  x"]
    (tmp_path / "log").write_text("\n".join(lines))
    assert run.cpu_seconds(tmp_path / "log") == pytest.approx(6.0)
    assert run.cpu_seconds(tmp_path / "none") == 0


def test_the_history_joins_the_runs(tmp_path):
    fire = toy_fire()

    def table(level, start, rows):
        for name, form in (("risePoints", "{0} (1 2 {1})" + " (1 2 5)" * 5), ("heatRelease", "{0}000001 {2}")):
            file = tmp_path / level / "postProcessing" / name / start
            file.mkdir(parents=True)
            text = "# Time\n" + "\n".join(form.format(*row) for row in rows)
            (file / ("U" if name == "risePoints" else "volFieldValue.dat")).write_text(text + "\n0.9 (1 2")

    table("coarse", "0", [(0.01, 7, 1e3), (0.08, 3, 2e3)])
    table("fine", "0.1", [(0.101, 8, 9e3), (0.12, 3, 2e3), (0.14, 9, 9e3)])  # the first: still what was mapped
    table("fine", "0.13", [(0.14, 4, 3e3)])  # a run that was killed after 0.14 went on from 0.13
    history = history_of(fire, tmp_path)
    assert history.time_s == pytest.approx((0.12 - 0.15, 0.14 - 0.15))
    assert history.heat_release_kw == pytest.approx((2.0, 3.0), rel=1e-3)
    assert [r[0] for r in history.rise_m_s] == [3.0, 4.0]


def test_a_folder_belongs_to_one_fire(tmp_path, foam):
    write_record(tmp_path / "fire.json", toy_fire(seed=1))
    with pytest.raises(DataFormatError, match="another fire"):
        run.bake(toy_fire(seed=2), tmp_path)


def test_a_program_that_fails_says_why(tmp_path, foam):
    write_case(toy_fire(), tmp_path, "fine")
    with pytest.raises(GofError, match="controlDict"):
        run._run(foam, tmp_path, "blockMesh")


def start(fire_file, out):
    return subprocess.Popen(
        [sys.executable, "-m", "gof_benchmark.solvers.openfoam", str(fire_file), "--out", str(out.parent)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.slow
def test_a_bake_that_is_killed_goes_on(tmp_path, foam):
    fire = toy_fire()
    write_record(tmp_path / "toy.json", fire)
    out = tmp_path / "toy"
    killed = 0
    # Killed in the warm-up, in the clip, and once more: each time the next run goes on.
    for wait in (lambda: run.times_of(out / "coarse")[1:], lambda: "0.15" in run.times_of(out / "fine")):
        process = start(tmp_path / "toy.json", out)
        deadline = time.monotonic() + 300
        while not wait() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        killed += process.poll() is None
        process.send_signal(signal.SIGKILL)
        process.communicate()
    finished = start(tmp_path / "toy.json", out)
    text = finished.communicate(timeout=500)[0]
    assert finished.returncode == 0, text
    assert killed and "coarse mesh" not in text
    grids = FireGrids.open(out / "grids")
    grids.check()
    assert grids.times_s == pytest.approx([0, 0.01, 0.02, 0.03]) and grids.velocity.resolution == (8, 8, 10)
    assert np.isfinite(grids.velocity.frame(3).velocity).all() and grids.velocity.frame(3).velocity[..., 2].max() > 0.05
    assert grids.description.cpu_s["fine"] > 0 and not run.times_of(out / "fine")
    assert json.loads((out / "grids" / "fire.json").read_text())["parameters"]["seed"] == fire.seed
    assert os.listdir(out / "steps")
