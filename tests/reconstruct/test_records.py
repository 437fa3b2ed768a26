"""settings.json, curve.json and captions.json: what is written is read, and what is older is refused by name."""

import json
from dataclasses import fields, replace

import pytest

from gof.core.errors import DataFormatError, GofError
from gof.core.records import read_record
from gof.reconstruct.captions import Caption, Captions
from gof.reconstruct.curve import Curve, CurveLog, CurvePoint, HeldOutScores
from gof.reconstruct.settings import ReconstructionSettings

SETTINGS = ReconstructionSettings("flame", iterations=10, gaussians=20, voxels=30, longest_side=40, seed=5)


def test_a_folder_belongs_to_one_set_of_settings(tmp_path):
    SETTINGS.claim(tmp_path)
    SETTINGS.claim(tmp_path)
    with pytest.raises(GofError, match=r"was begun with .*\(--no-flow-prior, --seed differ\); choose another --out"):
        replace(SETTINGS, seed=6, flow_prior=False).claim(tmp_path)
    (tmp_path / "result.npz").write_bytes(b"")
    with pytest.raises(GofError, match=r"result\.npz there is made with other settings \(--steps differ\)"):
        replace(SETTINGS, iterations=11).claim(tmp_path)


def test_a_folder_with_other_settings_is_replaced_by_overwrite_alone(tmp_path):
    other = replace(SETTINGS, longest_side=41)
    assert not SETTINGS.is_replaced(tmp_path, overwrite=True), "nothing is there"
    SETTINGS.claim(tmp_path)
    assert not SETTINGS.is_replaced(tmp_path, overwrite=True), "it goes on"
    assert other.is_replaced(tmp_path, overwrite=True)
    with pytest.raises(GofError, match=r"--max-size differ\); .*replace it with --overwrite"):
        other.is_replaced(tmp_path, overwrite=False)
    assert read_record(ReconstructionSettings, tmp_path / "settings.json") == SETTINGS, "asking writes nothing"
    (tmp_path / "settings.json").write_text(json.dumps({"mine": 1}))
    with pytest.raises(GofError, match="choose another --out or remove the folder"):
        other.is_replaced(tmp_path, overwrite=True)


def test_options_are_named_as_they_are_typed():
    """A field of the settings without an option of that name keeps its own."""
    from gof.commands.declared import options_of
    from gof.commands.reconstruct import ReconstructConfig
    from gof.reconstruct.settings import option_of

    typed = {option.name for option in options_of(ReconstructConfig)}
    named = {option_of(field.name) for field in fields(ReconstructionSettings)}
    assert {name for name in named if name.startswith("--")} <= typed
    assert {name for name in named if not name.startswith("--")} == {"dataset", "flow_prior_weights"}


def test_settings_of_an_older_version_are_refused_by_name(tmp_path):
    old = {"gaussians": 20, "iterations": 10, "voxels": 30, "dataset": "flame"}
    (tmp_path / "settings.json").write_text(json.dumps(old))
    with pytest.raises(GofError, match=r"settings\.json.*made by an older version; choose another --out"):
        SETTINGS.claim(tmp_path)


def test_a_result_without_settings_is_nobodys(tmp_path):
    """What lies there was not made by these settings, whoever made it."""
    (tmp_path / "result.npz").write_bytes(b"")
    with pytest.raises(GofError, match=r"settings\.json: no such file.*choose another --out"):
        SETTINGS.claim(tmp_path)


def scores_of(psnr: float) -> HeldOutScores:
    return HeldOutScores(psnr=psnr, psnr_flame=psnr - 5)


def test_the_curve_goes_on_after_an_interruption(tmp_path):
    log = CurveLog(tmp_path, resumed_s=None)
    for step in (250, 500, 1000):
        log.add(step, lambda: scores_of(30.0))
    before = Curve.read(tmp_path)
    assert before == log.curve
    resumed = CurveLog(tmp_path, resumed_s=80.0)  # from a checkpoint after step 250, say
    resumed.add(500, lambda: scores_of(31.0))
    points = Curve.read(tmp_path).points
    assert [point.step for point in points] == [250, 500], "what came after the checkpoint is made again"
    assert points[0] == before.points[0] and points[1].scores == scores_of(31.0)
    assert 80 <= points[1].seconds < 90, "its seconds add to those that the checkpoint had cost"
    assert CurveLog(tmp_path, resumed_s=None).curve == Curve(), "a new optimisation begins a new curve"


def test_scoring_takes_no_time_of_the_curve(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("gof.reconstruct.curve.time.perf_counter", lambda: now[0])
    log = CurveLog(tmp_path, resumed_s=None)

    def slow_score():
        now[0] += 1000
        return HeldOutScores()

    now[0] += 7
    assert log.add(250, slow_score).seconds == 7
    now[0] += 3
    assert log.add(500, slow_score).seconds == 10


def test_undefined_scores_are_null_and_an_older_curve_is_refused(tmp_path):
    CurveLog(tmp_path, resumed_s=None).add(1, HeldOutScores)
    written = json.loads((tmp_path / "curve.json").read_text())
    assert written["points"][0]["scores"]["psnr_flame_novel"] is None
    assert Curve.read(tmp_path).points[0].scores == HeldOutScores()
    (tmp_path / "curve.json").write_text(json.dumps([{"step": 1, "seconds": 0.1, "psnr": 30.0}]))
    with pytest.raises(DataFormatError, match=r"curve\.json"):
        Curve.read(tmp_path)


def test_points_are_in_order_of_steps():
    curve = Curve((CurvePoint(1, 0.1, scores_of(1)), CurvePoint(4, 0.4, scores_of(4))))
    steps = [point.step for point in curve.with_point(CurvePoint(4, 0.5, scores_of(5))).points]
    assert steps == [1, 4]


def test_captions_keep_the_order_of_the_stages(tmp_path):
    assert Captions.read(tmp_path) == Captions()
    captions = Captions().with_caption(Caption("1.png", "masks")).with_caption(Caption("2.png", "flow"))
    captions.with_caption(Caption("1.png", "new masks")).write(tmp_path)
    assert Captions.read(tmp_path).images == (Caption("1.png", "new masks"), Caption("2.png", "flow"))
