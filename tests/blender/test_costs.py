"""The cost model: what it counts, what it refuses; its coefficients are measured by `gof generate --estimate`."""

import itertools
from dataclasses import replace

import psutil
import pytest

from gof.errors import GofError
from gof_benchmark.generator import machine
from gof_benchmark.scenes import load_scene
from gof_blender.pure.spec import PRESETS
from gof_blender.scene.effects import fine_noise, motion_blur, rolling_shutter, smoke

DEMO = load_scene("demo")


def predicted(spec):
    return machine.predict(spec, machine.REFERENCE)


def test_cells_of_the_domain():
    assert machine.cells(DEMO) == 32 * 32 * 64


def test_presets_rise_in_cost():
    totals = [predicted(DEMO.with_preset(name)) for name in ("toy", "preview", "draft", "standard", "paper")]
    assert all(a.total_s < b.total_s and a.memory_mb < b.memory_mb for a, b in itertools.pairwise(totals))
    assert totals[1].total_s < 60
    assert set(PRESETS) == {"toy", "preview", "draft", "standard", "paper"}


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
        machine.refuse_if_too_large(huge, tmp_path)
    advice = int(str(error.value).split(" to ")[1].split(",")[0])
    assert (
        predicted(replace(DEMO, domain=replace(DEMO.domain, resolution=advice))).memory_mb
        < 0.9 * psutil.virtual_memory().total / 2**20
    )


def test_full_disk_is_seen_before_it_is_full(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("usage", (), {"free": 1000})())
    with pytest.raises(GofError, match="choose another output folder"):
        machine.refuse_if_too_large(DEMO, tmp_path)


@pytest.mark.slow
def test_prediction_holds_for_a_spec_it_was_not_fitted_to(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    measured = machine.calibrate()
    assert machine.known_machine() == measured and measured.error < 1.0
