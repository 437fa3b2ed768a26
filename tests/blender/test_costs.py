"""The cost model: what it counts, what it refuses; its coefficients are measured by `gof generate --estimate`."""

import itertools
import json
from dataclasses import replace

import psutil
import pytest

from gof.commands.cli import main
from gof.core.errors import GofError
from gof_benchmark.generator import machine
from gof_benchmark.scenes import load_scene
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import fine_noise, motion_blur, rolling_shutter, smoke
from gof_blender.pure.presets import PRESETS

DEMO = load_scene("demo")


def predicted(spec):
    return machine.predict(spec, machine.REFERENCE)


def test_cells_of_the_domain():
    assert machine.cells(DEMO) == 32 * 32 * 64


def test_presets_rise_in_cost():
    totals = [predicted(DEMO.with_preset(name)) for name in ("toy", "preview", "standard", "large", "full")]
    assert all(a.total_s < b.total_s and a.memory_mb < b.memory_mb for a, b in itertools.pairwise(totals))
    assert totals[1].total_s < 60
    assert set(PRESETS) == {"toy", "preview", "standard", "large", "full"}


@pytest.mark.parametrize(
    "effect, stage",
    [
        (fine_noise.Settings(), "bake_s"),
        (motion_blur.Settings(), "bake_s"),
        (rolling_shutter.Settings(), "render_s"),
        (smoke.Settings(), "render_s"),
    ],
)
def test_listed_effects_cost_and_others_do_not(effect, stage):
    with_it = replace(DEMO, effects=(*DEMO.effects, effect))
    assert getattr(predicted(with_it), stage) > 1.3 * getattr(predicted(DEMO), stage)


def test_too_large_is_refused_with_advice(tmp_path):
    huge = replace(DEMO, domain=replace(DEMO.domain, resolution=2048))
    with pytest.raises(GofError, match=r"lower domain\.resolution from 2048 to") as error:
        machine.require_machine_for(huge, tmp_path)
    advice = int(str(error.value).split(" to ")[1].split()[0])
    assert (
        predicted(replace(DEMO, domain=replace(DEMO.domain, resolution=advice))).memory_mb
        < 0.9 * psutil.virtual_memory().total / 2**20
    )


def test_an_estimate_is_given_of_what_does_not_fit_here(tmp_path, monkeypatch, capsys):
    """Hours and disk are what one who would rent a machine must know; then it is said why this one does not do."""
    monkeypatch.setattr(machine, "this_machine", lambda: machine.REFERENCE)
    spec = replace(DEMO, domain=replace(DEMO.domain, resolution=2048))
    scene_spec.save(spec, tmp_path / "huge.json")
    arguments = [str(tmp_path / "huge.json"), "--out", str(tmp_path / "out"), "--estimate"]
    status = main(["generate", *arguments, "--json", str(tmp_path / "costs.json")])
    said = capsys.readouterr()
    assert status == 1 and "lower domain.resolution" in said.err and "90 % may be used" in said.err
    expected = predicted(spec)
    assert str(expected) in said.out
    assert json.loads((tmp_path / "costs.json").read_text())["memory_mb"] == pytest.approx(expected.memory_mb)
    assert main(["generate", *arguments[:-1]]) == 1 and not (tmp_path / "out").exists()


def test_full_disk_is_seen_before_it_is_full(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("usage", (), {"free": 1000})())
    with pytest.raises(GofError, match="choose another output folder"):
        machine.require_machine_for(DEMO, tmp_path)


TRUE = replace(machine.REFERENCE, start=1.5, bake_power=1.2, sample_per_cell=3e-8)


def run_of(truth: machine.Machine, resolution: int, steps: int, pictures=()) -> machine.TinyRun:
    """A run of a machine whose coefficients are known, by the law in the docstring of `pure.cost_model`."""
    cells = 32 * 32 * 64 * resolution**3 // 64**3
    bake_s = truth.start + steps * truth.bake_scale * cells**truth.bake_power
    velocity_s = truth.start + machine.FRAMES * cells * truth.velocity
    rendered = tuple(
        (p, s, truth.picture + p * (truth.pixel + s * (truth.sample + truth.sample_per_cell * resolution)))
        for p, s in pictures
    )
    return machine.TinyRun(resolution, cells, steps, bake_s, velocity_s, rendered)


def test_calibration_finds_the_coefficients_of_a_machine_that_keeps_the_law():
    big, tiny = replace(TRUE, velocity=1e-6), ((57600, 4),)
    runs = (run_of(big, 8, 0), run_of(big, 32, 24, tiny), run_of(big, 56, 14, ((9216, 2), (57600, 2), (57600, 16))))
    found = machine.fit(*runs)
    for name in ("start", "bake_power", "bake_scale", "picture", "pixel", "sample", "sample_per_cell", "velocity"):
        assert getattr(found, name) == pytest.approx(getattr(big, name), rel=1e-3), name
    assert machine.prediction_error(found, run_of(big, 44, 20, ((29859, 8),))) < 1e-3


def test_a_first_start_that_takes_longer_than_a_bake_gives_an_estimate_all_the_same():
    """Read off a loaded machine: Blender, read from the disk, started in 0.80 s, and later baked 32 cells in 0.70."""
    pictures = ((9216, 2, 0.052), (57600, 2, 0.216), (57600, 16, 1.151))
    small = machine.TinyRun(32, 8192, 24, 0.695, 0.326, ((57600, 4, 0.373),))
    large = machine.TinyRun(56, 43904, 14, 1.228, 0.323, pictures)
    found = machine.fit(machine.TinyRun(8, 128, 2, 0.803, None, ()), small, large)
    unseen = machine.TinyRun(44, 21296, 20, 0.996, 0.339, ((29670, 8, 0.371),))
    assert machine.prediction_error(found, unseen) < 0.5
    assert machine.predict(DEMO, found).total_s < 2 * predicted(DEMO).total_s


def test_prediction_error_is_that_of_a_run_that_behaves_otherwise():
    unseen = run_of(TRUE, 44, 20, ((29859, 8),))
    pixels, samples, seconds = unseen.pictures[0]
    slower = replace(unseen, pictures=((pixels, samples, 2 * seconds),))
    assert machine.prediction_error(TRUE, slower) == pytest.approx(0.5)
    assert machine.prediction_error(TRUE, replace(slower, bake_s=unseen.bake_s / 3)) == pytest.approx(2.0)


@pytest.mark.slow
@pytest.mark.blender
def test_calibration_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    measured = machine.calibrate()
    assert machine.known_machine() == measured == machine.this_machine()


def test_a_machine_file_of_another_version_is_measured_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine.remember(TRUE)
    assert machine.known_machine() == TRUE
    (tmp_path / "gof" / "machine.json").write_text('{"start": 1.0}')
    assert machine.known_machine() is None


def test_a_calibration_that_was_stopped_goes_on(tmp_path, monkeypatch):
    """Runs of a machine whose law is known; stopped before the third, it measures only what is missing."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []

    def measure(demo, root, resolution, steps, pictures, tick):
        if len(made) == 2:
            made.append("stopped")
            raise KeyboardInterrupt
        made.append(root.name)
        tick()
        pixels = tuple((1280 * p // 100 * (720 * p // 100), s) for p, s in pictures)
        return run_of(TRUE, resolution, steps, pixels)

    monkeypatch.setattr(machine, "measure", measure)
    with pytest.raises(KeyboardInterrupt):
        machine.calibrate()
    assert machine.known_machine() is None
    found = machine.calibrate()
    assert made == ["empty", "small", "stopped", "large", "unseen"]
    assert found.bake_power == pytest.approx(TRUE.bake_power, rel=1e-3) and found.error < 0.01
    assert machine.known_machine() == found and not machine.Measured.path().exists()
    machine.Measured.path().write_text("{")
    assert machine.Measured.read() == {}
