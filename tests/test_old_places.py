"""Modules that moved are found at their old places for one version."""

import importlib
import sys
from pathlib import Path

import pytest

from gof.core.records import read_record
from gof.evaluate.leaderboard import Leaderboard
from gof.evaluate.scores import Scores
from gof.evaluate.suite_board import SuiteBoard
from gof.evaluate.training_curve import TrainingCurve
from gof_blender.pure.dve import MotionScores


@pytest.mark.parametrize("name, thing", [("gaussians", "TransientGaussians"), ("fields", "VelocityField")])
def test_an_old_place_is_the_new_one_and_says_so(name, thing):
    new = importlib.import_module(f"gof.core.{name}")
    sys.modules.pop(f"gof.{name}", None)
    with pytest.warns(DeprecationWarning, match=rf"gof\.{name} is now gof\.core\.{name}"):
        old = importlib.import_module(f"gof.{name}")
    assert getattr(old, thing) is getattr(new, thing)
    assert new.__spec__.name == new.__name__ == f"gof.core.{name}"


@pytest.mark.parametrize(
    "old, thing",
    [
        ("controls", "score_trivial_baselines"),
        ("gradients", "score_gradients"),
        ("perceptual", "lpips"),
        ("published", "published_figures"),
        ("statistics", "over_frames"),
        ("weighted", "weighted_quantile"),
    ],
)
def test_what_was_folded_is_found_by_its_old_name(old, thing):
    with pytest.warns(DeprecationWarning, match=rf"gof\.evaluate\.{old} is now gof\.evaluate\."):
        module = importlib.import_module(f"gof.evaluate.{old}")
    assert callable(getattr(module, thing))


def test_what_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("gof.nothing")


def _as_0_2_wrote(text: str) -> str:
    """A record's file of today in the words of version 0.2."""
    return (
        text.replace('"trivial_baselines', '"controls')
        .replace('"trivial_baseline"', '"control"')
        .replace('"cpu_seconds"', '"processor_seconds"')
    )


@pytest.mark.parametrize("schema", ["gof-scores", "gof-leaderboard", "gof-suite-board"])
def test_files_with_the_old_words_are_read(schema, tmp_path):
    kind = {"gof-scores": Scores, "gof-leaderboard": Leaderboard, "gof-suite-board": SuiteBoard}[schema]
    today = Path(__file__).parent / "golden" / f"{schema}.json"
    (tmp_path / "old.json").write_text(_as_0_2_wrote(today.read_text()))
    assert (tmp_path / "old.json").read_text() != today.read_text()
    assert read_record(kind, tmp_path / "old.json") == read_record(kind, today)


def test_scores_and_curves_have_their_old_names(tmp_path):
    golden = Path(__file__).parent / "golden" / "gof-scores.json"
    scores = read_record(Scores, golden)
    with pytest.warns(DeprecationWarning, match=r"scores\.trivial_baselines"):
        assert scores.controls == scores.trivial_baselines != {}
    (tmp_path / "gof-scores.json").write_text(_as_0_2_wrote(golden.read_text()))
    of_the_add_on = MotionScores.read(tmp_path / "gof-scores.json")
    assert of_the_add_on == MotionScores.read(golden) and of_the_add_on.trivial_baselines.zero is not None
    (tmp_path / "curve.csv").write_text("step,processor_seconds,loss\n10,1,0.5\n20,2,0.25\n")
    assert TrainingCurve.read(tmp_path / "curve.csv").cpu_seconds == (1.0, 2.0)
