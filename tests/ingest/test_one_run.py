"""A folder of `gof ingest` is one run's: two at once, one after a run that was cut off, and what was there before."""

import json
import multiprocessing
import os
import signal

import pytest

from gof.commands import cli
from gof.core.files import only_run_in
from gof.ingest import footage, pipeline
from tests.ingest.test_picture_folders import moments, rig, words

COUNT = 10


def given(root):
    return rig(root, [f"{k:04d}" for k in range(COUNT)], range(COUNT))


def contents(folder):
    """Names and bytes of a dataset's files, but for costs and hidden ones."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "costs.json" and not path.name.startswith(".")
    }


def killed_at(arguments, frame):
    """Run `gof ingest`, and kill it when it has written so many pictures."""
    save, count = footage.save_picture, 0

    def counted(path, picture):
        nonlocal count
        save(path, picture)
        count += 1
        if count == frame:
            os.kill(os.getpid(), signal.SIGKILL)

    footage.save_picture = counted
    cli.main(arguments)


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
def test_a_run_that_was_cut_off_leaves_nothing_in_the_next_dataset(tmp_path):
    """The next one has other frames and a smaller size; it is the same as in an empty folder."""
    arguments = given(tmp_path)
    fork = multiprocessing.get_context("fork")
    run = fork.Process(target=killed_at, args=(arguments, 25))
    run.start()
    run.join()
    assert run.exitcode == -signal.SIGKILL
    half = contents(tmp_path / "ds")
    assert len(half) > 20 and "dataset.json" not in half
    other = ["--start", "2", "--frames", "4", "--max-size", "64"]
    assert cli.main([*arguments, *other]) == 0
    clean = [*arguments, *other]
    clean[clean.index("--out") + 1] = str(tmp_path / "clean" / "ds")
    assert cli.main(clean) == 0
    assert contents(tmp_path / "ds") == contents(tmp_path / "clean/ds")
    assert not list((tmp_path / "ds").rglob(".*partial*")) and not (tmp_path / "ds" / pipeline.UNFINISHED).exists()


def test_two_runs_in_one_folder_are_refused(tmp_path, capsys):
    arguments = given(tmp_path)
    with only_run_in(tmp_path / "ds"):
        assert cli.main([*arguments, "--max-size", "64"]) == 1
    assert "another run is at work there" in words(capsys)
    assert not contents(tmp_path / "ds")
    assert cli.main(arguments) == 0 and moments(tmp_path) == [(k, k) for k in range(COUNT)]
    assert json.loads((tmp_path / "ds/dataset.json").read_text())


def test_files_that_no_run_left_are_never_removed(tmp_path, capsys):
    arguments = given(tmp_path)
    mine = tmp_path / "ds/cameras/cam_0/rgb/000000.png"
    mine.parent.mkdir(parents=True)
    mine.write_bytes(b"precious")
    assert cli.main(arguments) == 1
    assert "ds: holds cameras, with which a dataset would mix" in words(capsys)
    assert contents(tmp_path / "ds") == {"cameras/cam_0/rgb/000000.png": b"precious"}
