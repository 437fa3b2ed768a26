"""What killed runs leave behind, and that the next run of the command removes it."""

import os
import signal
import subprocess
import sys
import time

import pytest

from gof.core import drafts
from gof.core.files import atomic_path, write_json

KILLED = """
import sys, time
from pathlib import Path
from gof.core.drafts import whole_folder
from gof.core.files import atomic_path
with {how}(Path(sys.argv[1])) as draft:
    (draft if "{how}" == "atomic_path" else draft / "x").write_bytes(bytes(1000))
    print("there", flush=True)
    time.sleep(60)
"""


def killed_run(path, how):
    """A run that is killed while it writes `path`. Returns the names it leaves."""
    run = subprocess.Popen([sys.executable, "-c", KILLED.format(how=how), path], stdout=subprocess.PIPE, text=True)
    assert run.stdout.readline() == "there\n"
    run.send_signal(signal.SIGKILL)
    run.wait()
    left = [p for p in path.parent.iterdir() if "partial" in p.name]
    assert len(left) == 1 and not path.exists()
    return left[0]


@pytest.fixture(autouse=True)
def a_new_run():
    """Each test stands for a process of its own."""
    drafts._cleaned.clear()


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX does")
@pytest.mark.parametrize("how", ["atomic_path", "whole_folder"])
def test_the_next_run_removes_what_a_killed_one_left(tmp_path, how):
    left = killed_run(tmp_path / "dataset.tar", how)
    other = tmp_path / ".dataset.partial.tar"  # not named as ours are
    other.write_text("somebody else's")
    with atomic_path(tmp_path / "another.json") as draft:
        draft.write_text("{}")
        assert not left.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == [other.name, "another.json"]


def test_drafts_of_runs_that_go_on_stay(tmp_path):
    """Of this computer's processes, by their numbers; of another one's, by their age."""
    mine = tmp_path / f".a.{drafts.HOST}-{os.getppid()}.partial.png"
    theirs, old = (tmp_path / f".{name}.01234567-99.partial.png" for name in ("theirs", "old"))
    for path in (mine, theirs, old):
        path.write_text("x")
    os.utime(old, (time.time() - 2e5,) * 2)
    write_json(tmp_path / "b.json", {})
    assert mine.exists() and theirs.exists() and not old.exists()


def test_a_draft_that_is_a_link_is_removed_and_not_followed(tmp_path):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "file").write_text("x")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    (tmp_path / f".a.{drafts.HOST}-{ended.pid}.partial").symlink_to(precious)
    drafts.remove_drafts(tmp_path)
    assert (precious / "file").exists() and [p.name for p in tmp_path.iterdir()] == ["precious"]
