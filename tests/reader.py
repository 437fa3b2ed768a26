"""The folder of somebody who reads the pages: the sample that comes with the package, under the names that they use."""

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gof.commands.cli import main
from gof.core.ply import splat_columns, write
from gof.sample import unpack_sample

ROOT = Path(__file__).parents[1]
SMALL = {  # command: words put behind it
    "gof background": "--steps 5 --max-size 64",
    "gof generate": "--preset toy",
    "gof reconstruct": "--steps 20 --gaussians 300 --voxels 24 --max-size 64",
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
    wall = np.stack(np.meshgrid(np.linspace(-1, 1, 8), [0.8], np.linspace(0, 2, 8), indexing="ij"), -1).reshape(-1, 3)
    shape = {"scale": np.full((64, 3), 0.1), "rotation": np.tile([1.0, 0, 0, 0], (64, 1)), "opacity": np.full(64, 0.9)}
    write(folder / "room.ply", splat_columns({"position": wall, "color": np.full((64, 3), 0.4), **shape}), [])
    for film in (folder / "sample/clip").iterdir():
        shutil.copyfile(film, folder / film.name)
    for take in ("takes/1", "takes/2"):
        (folder / take).mkdir(parents=True)
        for film in (folder / "sample/clip").glob("*.mp4"):
            shutil.copyfile(film, folder / take / film.name)
        shutil.copytree(folder / "data/fire", folder / "data" / take, copy_function=os.link)
    return folder


# The sample's files have two names here, as README and the helps have them; where a command writes is no other work.
ONE_NAME = (("sample/clip/", ""), ("sample/fire", "data/fire"), ("out/sync", "sync"), ("sample/result", "out/fire"))
ONE_NAME += (("cam_*.mp4", "cam_0.mp4 cam_1.mp4 cam_2.mp4"), ("data/board", "data/fire"))
# Page: a package that it needs, beyond the core.
TUTORIALS = {"benchmark": "bpy", "score": "torch", "film": "pycolmap", "blender_flame": "gof"}


def work_of(line: str) -> str:
    """A command as every page's one: the same work on the same files. Places of output: tests/test_outputs.py."""
    for one, other in ONE_NAME:
        line = line.replace(one, other)
    return " ".join(re.sub(r" --out( (?!-)\S+)+", "", line).split())


def tutorials() -> set[str]:
    """`work_of` every command of the tutorials that run on this machine, in tests/test_site.py."""
    here = [page for page, package in TUTORIALS.items() if find_spec(package)]
    texts = [(ROOT / f"docs/tutorials/{page}.md").read_text(encoding="utf-8") for page in here]
    blocks = [block for text in texts for block in re.findall(r"^```bash\n(.*?)^```", text, re.MULTILINE | re.DOTALL)]
    return {work_of(line) for block in blocks for line in block.splitlines() if line.startswith("gof ")}


def not_run_elsewhere(lines: list[str], elsewhere: set[str]) -> list[str]:
    """The commands of a page without those whose work another page runs, unless one that is run takes what they make.

    Args:
        elsewhere: `work_of` the others.
    """
    found: list[str] = []
    for line in reversed(lines):
        made = re.search(r"--out (\S+)", line)
        taken = made and made[1] not in IN_THE_SAMPLE and any(made[1] in later for later in found)
        if work_of(line) not in elsewhere or taken:
            found.insert(0, line)
    return found


def clear(folder: Path, text: str) -> None:
    """Remove what the sample has and these commands make."""
    for made in MADE.findall(text):
        shutil.rmtree(folder / made, ignore_errors=True)


def run(folder: Path, text: str, language: str = "bash", small: bool = True) -> str:
    """Run a command or a block as the reader's shell or Python does; `small`: made so. Returns what it prints.

    Raises:
        AssertionError: it failed.
    """
    if language == "bash":
        text = text.replace("\\\n", " ")
        text = re.sub(r"^(gof [^#\n]*?) *(#.*)?$", _small if small else r"\1", text, flags=re.MULTILINE)
        lines = [_with_files(folder, line) for line in text.splitlines()]
        if all(line.startswith("gof ") for line in lines) and not any(map(IN_A_SHELL.search, lines)):
            return "".join(_run_here(folder, line) for line in lines)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "PYTHONPATH": os.environ.get("PYTHONPATH", str(ROOT))}
    command = ["bash", "-ec", text] if language == "bash" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=550)
    assert done.returncode == 0, f"{text}\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
    return done.stdout + done.stderr


def _with_files(folder: Path, line: str) -> str:
    """A command whose words with a * are the files that a shell puts there, in its order."""
    words = line.split(" ")
    found = [sorted(path.relative_to(folder).as_posix() for path in folder.glob(w)) if "*" in w else [w] for w in words]
    return " ".join(name for names, word in zip(found, words, strict=True) for name in names or [word])


def _run_here(folder: Path, line: str) -> str:
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
    return said.getvalue()


def _small(line: re.Match) -> str:
    return " ".join([line[1], *(more for words, more in SMALL.items() if line[1].startswith(words))])
