"""Several takes by one command: each folder's videos become a dataset, each dataset a flame, and one may fail."""

import json

import numpy as np
import pytest

from gof.commands import cli
from gof.commands.each import folder_of_each, run_each
from gof.core.errors import GofError
from gof.footage.pictures import write_picture
from tests.ingest.test_one_run import contents
from tests.ingest.test_picture_folders import arguments, picture, words
from tests.reconstruct.rising_flame import write_flame
from tests.videos import write_video

TINY = ["--steps", "2", "--gaussians", "50", "--voxels", "12", "--anyway"]


def write_takes(root, names=("one", "two"), frames=8):
    """Folders with c0.mp4 and c1.MP4. Returns the options of `gof ingest`, of known cameras."""
    for k, name in enumerate(names):
        for c in range(2):
            (root / "takes" / name).mkdir(parents=True, exist_ok=True)
            pictures = [picture(c, moment + k) for moment in range(frames)]
            film = write_video(root / "takes" / name / f"c{c}.mp4", pictures)
            if c:
                film.rename(film.with_suffix(".MP4"))
    given = arguments(root)
    return [*given[given.index("--times") :]]


def datasets(root):
    return sorted(path.parent.relative_to(root).as_posix() for path in root.rglob("dataset.json"))


def test_each_folder_of_videos_is_a_take(tmp_path, capsys):
    options = write_takes(tmp_path)
    takes = [str(tmp_path / "takes" / name) for name in ("one", "two")]
    (tmp_path / "takes/two/._c0.mp4").write_bytes(b"macOS")
    (tmp_path / "takes/two/notes.txt").write_text("windy")
    figures = tmp_path / "figures.json"
    assert cli.main(["ingest", *takes, "--out", str(tmp_path / "data"), *options, "--json", str(figures)]) == 0
    assert datasets(tmp_path) == ["data/one", "data/two"]
    runs = json.loads(figures.read_text())["runs"]
    assert [run["source"] for run in runs] == takes
    assert [run["dataset"] for run in runs] == [str(tmp_path / "data" / name) for name in ("one", "two")]
    assert "1 of 2: " in words(capsys)
    assert cli.main(["ingest", takes[0], *options]) == 0, "a single one goes beside its folder"
    assert datasets(tmp_path)[-1] == "takes/one_dataset"


def test_a_take_that_fails_does_not_end_the_others(tmp_path, capsys):
    options = write_takes(tmp_path, ("one", "torn", "two"))
    (tmp_path / "takes/torn/c0.mp4").write_bytes(b"no film")
    takes = [str(tmp_path / "takes" / name) for name in ("one", "torn", "two")]
    figures = tmp_path / "figures.json"
    assert cli.main(["ingest", *takes, "--out", str(tmp_path / "data"), *options, "--json", str(figures)]) == 1
    assert datasets(tmp_path) == ["data/one", "data/two"]
    told = words(capsys)
    assert "1 of 3 failed" in told and "torn/c0.mp4" in told.partition("failed:")[2]
    assert ["error" in run for run in json.loads(figures.read_text())["runs"]] == [False, True, False]


def test_a_stopped_command_keeps_the_takes_that_are_finished(tmp_path, capsys):
    """Of the same videos; others in a finished dataset's place are refused, and --overwrite makes all anew."""
    options = write_takes(tmp_path)
    takes = [str(tmp_path / "takes" / name) for name in ("one", "two")]
    asked = ["ingest", *takes, "--out", str(tmp_path / "data"), *options, "--json", str(tmp_path / "figures.json")]
    assert cli.main(asked) == 0
    made = tmp_path / "data/one/dataset.json"
    before = made.stat().st_mtime_ns
    capsys.readouterr()
    assert cli.main(asked) == 0
    assert "data/one: is there already" in words(capsys) and made.stat().st_mtime_ns == before
    runs = json.loads((tmp_path / "figures.json").read_text())["runs"]
    assert [run["dataset"] for run in runs] == [str(tmp_path / "data" / name) for name in ("one", "two")]
    (tmp_path / "takes/one/c0.mp4").unlink()
    write_video(tmp_path / "takes/one/c0.mp4", [picture(0, moment + 5) for moment in range(8)])
    assert cli.main(asked) == 1
    assert "already holds a dataset; choose another --out, or replace it with --overwrite" in words(capsys)
    of_itself = ["ingest", takes[1], "--out", str(tmp_path / "data/two"), *options, "--overwrite"]
    assert cli.main([*of_itself, "--plates", str(tmp_path / "data/two/static")]) == 1
    assert "static: lies in" in words(capsys) and (tmp_path / "data/two/dataset.json").is_file()
    (tmp_path / "data/two/notes.txt").write_text("windy")
    (tmp_path / "data/two/costs.json").write_text("of the run before")
    assert cli.main([*asked, "--overwrite"]) == 0
    assert made.stat().st_mtime_ns > before and (tmp_path / "data/two/notes.txt").read_text() == "windy"


def test_a_dataset_is_replaced_only_when_the_next_is_ready(tmp_path, capsys):
    """The plates of the next are of another size, which shows only after the films were read."""
    options = write_takes(tmp_path, ("one",))
    asked = ["ingest", str(tmp_path / "takes/one"), "--out", str(tmp_path / "ds"), *options]
    assert cli.main(asked) == 0
    before = contents(tmp_path / "ds") | {"costs.json": (tmp_path / "ds/costs.json").read_bytes()}
    plates = tmp_path / "plates"
    plates.mkdir()
    for c in range(2):
        write_picture(plates / f"cam_{c}.png", np.zeros((8, 8, 3), np.uint8))
    capsys.readouterr()
    assert cli.main([*asked, "--plates", str(plates), "--overwrite"]) == 1
    assert "plates/cam_0.png" in words(capsys)
    assert contents(tmp_path / "ds") | {"costs.json": (tmp_path / "ds/costs.json").read_bytes()} == before
    assert cli.main([*asked, "--start", "2", "--overwrite"]) == 0
    assert contents(tmp_path / "ds").keys() < before.keys(), "the pictures of frames that it has no more are gone"


def test_a_dataset_of_another_kind_is_not_replaced(tiny_dataset, tmp_path, capsys):
    """By --overwrite go datasets made of footage alone: this one has a truth that footage has not."""
    options = write_takes(tmp_path, ("one",))
    description = (tiny_dataset / "dataset.json").read_bytes()
    words_given = ["ingest", str(tmp_path / "takes/one"), "--out", str(tiny_dataset), *options, "--overwrite"]
    assert cli.main(words_given) == 1
    assert "already holds a dataset" in words(capsys)
    assert (tiny_dataset / "dataset.json").read_bytes() == description


@pytest.mark.parametrize(
    ("given", "error"),
    [
        (["takes/one", "takes/none"], "takes/none: holds no videos"),
        (["takes/one", "nope"], "nope: no such folder"),
        (["takes/mixed", "takes/one"], "takes/mixed: holds pictures, but takes/one"),
        (["takes/one", "takes/two/c0.mp4"], "takes/two/c0.mp4: is a file"),
        (["takes"], "takes: holds folders with videos, as one; give these: takes/*"),
    ],
)
def test_the_word_that_is_no_take_is_named(tmp_path, capsys, monkeypatch, given, error):
    options = write_takes(tmp_path, ("one", "two", "mixed"))
    (tmp_path / "takes/none").mkdir()
    (tmp_path / "takes/mixed/board.png").write_bytes(b"a picture of the board")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["ingest", *given, "--out", "data", *options]) == 1
    told = words(capsys)
    assert error in told and "takes/one:" not in told and datasets(tmp_path) == []


@pytest.mark.parametrize(
    ("option", "words_of_it"), [("--points", ["marks.json"]), ("--start", ["0", "1"]), ("--times", ["sync/times.json"])]
)
def test_what_holds_for_one_take_is_refused_for_several(tmp_path, capsys, option, words_of_it):
    options = write_takes(tmp_path)
    if option == "--times":
        options = options[2:]
    takes = [str(tmp_path / "takes" / name) for name in ("one", "two")]
    assert cli.main(["ingest", *takes, *options, option, *words_of_it]) == 1
    assert f"{option}{' FILE' * (option == '--times')}: holds for one take" in words(capsys)
    assert datasets(tmp_path) == []


def test_two_of_one_name_are_refused_where_they_would_share_a_folder(tmp_path):
    same = [tmp_path / "a/fire", tmp_path / "b/fire"]
    with pytest.raises(GofError, match="two of them are named fire"):
        folder_of_each(same, tmp_path / "out")
    assert folder_of_each(same, None)(same[0]) is None
    assert folder_of_each(same[:1], tmp_path / "out")(same[0]) == tmp_path / "out"


def test_faults_of_ours_end_everything(tmp_path):
    with pytest.raises(ZeroDivisionError):
        run_each([tmp_path / "a", tmp_path / "b"], lambda source: 1 / 0)


def test_several_datasets_are_reconstructed_one_after_the_other(tmp_path, capsys):
    folders = [str(write_flame(tmp_path / name, frames=6)) for name in ("one", "two")]
    out = tmp_path / "out"
    assert cli.main(["reconstruct", *folders, "--out", str(out), *TINY]) == 0
    assert [path.parent.name for path in sorted(out.rglob("result.npz"))] == ["one", "two"]
    assert "2 of 2: " in words(capsys)
    missing = str(tmp_path / "three")
    assert cli.main(["reconstruct", folders[0], missing, "--out", str(tmp_path / "again"), *TINY]) == 1
    assert not (tmp_path / "again").exists(), "all are opened before hours of work"
