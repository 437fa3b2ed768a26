"""The folder of somebody who reads the pages: the sample that comes with the package, under the names that they use."""

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from gof.commands.cli import main
from gof.sample import unpack_sample

ROOT = Path(__file__).parents[1]
SMALL = {  # command: words put behind it
    "gof background": "--steps 5",
    "gof generate": "--preset toy",
    "gof reconstruct": "--steps 20 --gaussians 300 --voxels 24",
    "gof video": "--max-size 64 --fps 2",
}
IN_A_SHELL = re.compile(r"[|&;<>$*?~`(){}#!]")  # a line with one of these is more than one command
IN_THE_SAMPLE = ("data/fire", "out/fire")  # what commands make and `lay_out` gives
MADE = re.compile(r"^gof (?:generate|ingest|reconstruct|background) .*--out (\S+)", re.MULTILINE)


def lay_out(folder: Path) -> Path:
    """Give the sample the names that README, helps and docs use."""
    unpack_sample(folder / "sample")
    shutil.copytree(folder / "sample/fire", folder / "data/fire")
    for name, part in (("out/fire", "result"), ("boards/ours", "result"), ("boards/theirs", "submission/fire")):
        shutil.copytree(folder / "sample" / part, folder / name)
    run(folder, "gof evaluate boards/ours --dataset data/fire --no-images")
    run(folder, "gof convert boards/theirs/result.npz out/other.ply")
    (folder / "out/demo").mkdir()
    (folder / "out/demo/dataset").symlink_to(Path("../../data/fire"))
    (folder / "out/demo/reconstruct").symlink_to(Path("../fire"))
    for film in (folder / "sample/clip").iterdir():
        shutil.copyfile(film, folder / film.name)
    return folder


def not_run_elsewhere(lines: list[str], elsewhere: set[str]) -> list[str]:
    """The commands of a page without those that another page runs, unless one after them takes what they make."""
    found = []
    for number, line in enumerate(lines):
        made = re.search(r"--out (\S+)", line)
        taken = made and made[1] not in IN_THE_SAMPLE and any(made[1] in later for later in lines[number + 1 :])
        if line not in elsewhere or taken:
            found.append(line)
    return found


def clear(folder: Path, text: str) -> None:
    """Remove what the sample has and these commands make."""
    for made in MADE.findall(text):
        shutil.rmtree(folder / made, ignore_errors=True)


def run(folder: Path, text: str, language: str = "bash") -> None:
    """Run a command or a block as the reader's shell or Python does, made small. Raises AssertionError: it failed."""
    if language == "bash":
        text = text.replace("\\\n", " ")
        text = re.sub(r"^(gof [^#\n]*?) *(#.*)?$", _small, text, flags=re.MULTILINE)
        lines = text.splitlines()
        if all(line.startswith("gof ") for line in lines) and not any(map(IN_A_SHELL.search, lines)):
            for line in lines:
                _run_here(folder, line)
            return
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "PYTHONPATH": os.environ.get("PYTHONPATH", str(ROOT))}
    command = ["bash", "-ec", text] if language == "bash" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=550)
    assert done.returncode == 0, f"{text}\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"


def _run_here(folder: Path, line: str) -> None:
    """Run one command in this process, which is much faster. Raises AssertionError: it failed."""
    said, before = io.StringIO(), Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = main(shlex.split(line)[1:])
    except SystemExit as e:
        status = e.code
    finally:
        os.chdir(before)
    assert not status, f"{line}\n{said.getvalue()[-5000:]}"


def _small(line: re.Match) -> str:
    return " ".join([line[1], *(more for words, more in SMALL.items() if line[1].startswith(words))])
