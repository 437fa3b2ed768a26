"""Scores belong to one dataset and one result: a mix-up is named wherever scores are made, compared or shown."""

import json
import shutil
import subprocess
import sys

import pytest

import gof
from gof.commands import cli
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.leaderboard import collect, rows_of
from gof.evaluate.scores import Scores
from tests.reconstruct.rising_flame import column, write_flame


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Dataset one, two (fewer frames) and copy (of one); result, which says that it was made of one."""
    root = tmp_path_factory.mktemp("others")
    one = Dataset.open(write_flame(root / "one", frames=6))
    write_flame(root / "two", frames=5)
    shutil.copytree(root / "one", root / "copy")  # keeps times of change
    (root / "result").mkdir()
    column(one.times_s).save(root / "result/result.npz")
    settings = {"schema": "gof-reconstruction-settings", "version": 7, "dataset": one.identity()}
    (root / "result/settings.json").write_text(json.dumps(settings))
    return root


def evaluated(work, dataset, out):
    assert cli.main(["evaluate", str(work / "result"), "--dataset", str(work / dataset), "--no-images",
                     "--out", str(out)]) == 0  # fmt: skip
    return Scores.read(out / "scores.json")


def test_scores_say_of_which_dataset_they_are_and_warn_of_another(work, tmp_path):
    own, other = evaluated(work, "one", tmp_path / "own"), evaluated(work, "two", tmp_path / "other")
    assert not any("ANOTHER FIRE" in text for text in own.warnings)
    assert any("was made of the dataset 'one" in text or "ANOTHER FIRE" in text for text in other.warnings)
    assert own.dataset == Dataset.open(work / "copy").scored_as() != other.dataset


def test_another_programs_settings_are_not_ours(work, tmp_path):
    shutil.copytree(work / "result", tmp_path / "result")
    for text in ('{"dataset": "elsewhere"}', "[1]"):
        (tmp_path / "result/settings.json").write_text(text)
        warnings = gof.evaluate(tmp_path / "result/result.npz", work / "one", images=False).warnings
        assert not any("ANOTHER" in text for text in warnings)


def test_results_of_other_datasets_do_not_compete(work, tmp_path, capsys):
    for name, dataset in (("a", "one"), ("b", "two"), ("c", "copy")):
        evaluated(work, dataset, tmp_path / name)
    folders = [tmp_path / name for name in "abc"]
    rows = rows_of(collect([folders[0], folders[1] / "scores.json", folders[2]]))
    assert [row.competes for row in rows] == [True, False, True]
    assert "scored on another dataset" in rows[1].notes[0]
    assert [row.competes for row in rows_of(collect(folders), Dataset.open(work / "two").scored_as())] == [0, 1, 0]
    capsys.readouterr()
    assert cli.main(["leaderboard", *map(str, folders), "--out", str(tmp_path / "board")]) == 0
    assert "note: b: scored on another dataset" in " ".join(capsys.readouterr().out.split())


def test_a_report_shows_the_result_that_was_scored(work, tmp_path, capsys):
    evaluated(work, "one", tmp_path / "scored")
    other = tmp_path / "other/result.npz"
    other.parent.mkdir()
    TransientGaussians.load(work / "result/result.npz")[:50].save(other)
    arguments = ["report", str(tmp_path / "scored"), "--dataset", str(work / "one")]
    assert cli.main([*arguments, "--result", str(other)]) == 1
    assert "the scores are those of" in capsys.readouterr().err
    assert cli.main(arguments) == 0, "without --result what scores.json names"
    assert (tmp_path / "scored/report.html").is_file()
    assert cli.main([*arguments, "--result", str(work / "result")]) == 0, "its folder will do"


def test_pages_and_flow_warn_of_another_dataset(work, tmp_path, capsys):
    for command in (["share"], ["flow", "--files", "png"]):
        out = tmp_path / f"{command[0]}.html"
        assert cli.main([*command[:1], str(work / "result"), *command[1:], "--dataset", str(work / "two"),
                         "--out", str(out)]) == 0  # fmt: skip
        assert "ANOTHER FIRE" in capsys.readouterr().err


def test_what_was_read_can_be_scored(work):
    read = gof.read_result(work / "result")
    scores = gof.evaluate(read, work / "one", images=False)
    assert scores.dve.l2 == gof.evaluate(work / "result", work / "one", images=False).dve.l2
    assert scores.import_.path == str(read.path)


def test_scores_are_written_before_their_reader_leaves(work, tmp_path):
    """`gof evaluate ... | head -1`."""
    command = [sys.executable, "-m", "gof", "evaluate", str(work / "result"), "--dataset", str(work / "one"),
               "--no-images", "--out", str(tmp_path / "out")]  # fmt: skip
    done = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    done.stdout.close()
    done.wait(timeout=120)
    assert (tmp_path / "out/scores.json").is_file()
