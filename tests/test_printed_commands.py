"""Every command that README, `gof --help` and the help of each command print is run as printed, in its order.

What a reader has by then is `gof sample`, and what the commands before made. Sizes are made small (`SMALL`), nothing
else is changed. What is not run stands in `NOT_RUN` with the reason. What errors and notes name exists.
"""

import ast
import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from gof.commands.cli import commands, main
from gof.sample import unpack_sample

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
GROUPS = ("benchmark", "capture", "figure", "study")  # `gof GROUP PART`: each part has options of its own
LINE = re.compile(r"^ *(gof [a-z]+ (?!- ).*?)(?: {3,}.*)?$", re.MULTILINE)  # three blanks, then what it makes

SERVER, HOURS, HARDWARE = "serves pages until it is stopped", "takes hours", "needs the board, or printed targets"
OTHERS, SUITE = "needs other people's code or files", "tests/suite walks this way, with smaller scenes"
NOT_RUN = {  # words that the command begins with: why
    "gof baseline": OTHERS,
    "gof benchmark make": SUITE,
    "gof reconstruct bench/": SUITE,
    "gof benchmark add": SUITE,
    "gof benchmark check": SUITE,
    "gof benchmark score": SUITE,
    "gof capture board": HARDWARE,
    "gof capture calibrate": HARDWARE,
    "gof convert chkpnt30000.pth": OTHERS,
    "gof evaluate CHECKPOINT": OTHERS,
    "gof study generate": HOURS,
    "gof study reconstruct": HOURS,
    "gof study ablations": HOURS,
    "gof view": SERVER,
    "gof ingest a.mp4": OTHERS,
    "gof completion": "writes into the home folder; tests/test_command_line.py runs it",
    "gof demo": "tests/test_demo.py walks this way, with a smaller fire",
    "gof generate demo --estimate": "measures the machine for minutes",
}
BEFORE = {  # page: what its reader has done before
    "gof ingest": "gof capture sync cam_0.mp4 cam_1.mp4 cam_2.mp4 --out sync",
    "gof unpack": "gof pack data/fire --licence CC0-1.0 --authors A --out .",
    "gof report": "gof evaluate out/fire --dataset data/fire --no-images",
}
SMALL = {  # command: words put behind it
    "gof background": "--steps 5",
    "gof generate": "--preset toy",
    "gof reconstruct": "--steps 20 --gaussians 300 --voxels 24",
    "gof study dve": "--gaussians 100",
    "gof video": "--max-size 64 --fps 2",
}
BLENDER = ("gof demo", "gof generate", "gof import")


def help_of(*words: str) -> str:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*words, "--help-all"])
    return printed.getvalue()


@cache
def pages() -> dict[str, list[str]]:
    """Commands by the page that prints them, in its order."""
    table = README.read_text(encoding="utf-8").split("| I want to | command |")[1].split("\n\n")[0]
    found = {"README": re.findall(r"`(gof [a-z][^`]*)`", table)}
    found["gof"] = LINE.findall(help_of())
    for name in commands():
        if name == "baseline":
            continue  # its help is that of another process
        text = help_of(name)
        found[f"gof {name}"] = LINE.findall(text)
        if name in GROUPS:
            for part in re.findall(r"^  ([a-z]+)  ", text, re.MULTILINE):
                found[f"gof {name} {part}"] = LINE.findall(help_of(name, part))
    return {page: lines for page, lines in found.items() if lines}


def reason(line: str) -> str | None:
    return next((why for words, why in NOT_RUN.items() if line.startswith(words)), None)


def test_what_is_not_run_is_printed_somewhere():
    lines = [line for lines in pages().values() for line in lines]
    for words in NOT_RUN:
        assert any(line.startswith(words) for line in lines), f"nothing prints {words!r}"
    assert len(pages()["README"]) >= 15 and len(pages()["gof"]) >= 5


# ---------------------------------------------------------------- running them


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with the sample under the names that the pages use, made once."""
    folder = tmp_path_factory.mktemp("made")
    unpack_sample(folder / "sample")
    shutil.copytree(folder / "sample/fire", folder / "data/fire")
    for name, part in (("out/fire", "result"), ("boards/ours", "result"), ("boards/theirs", "submission/fire")):
        shutil.copytree(folder / "sample" / part, folder / name)
    for line in (
        "gof evaluate boards/ours --dataset data/fire --no-images",
        "gof convert boards/theirs/result.npz out/other.ply",
    ):
        done = run(line, folder)
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    (folder / "out/demo").mkdir()
    (folder / "out/demo/dataset").symlink_to("../../data/fire")
    (folder / "out/demo/reconstruct").symlink_to("../fire")
    for film in (folder / "sample/clip").iterdir():
        shutil.copyfile(film, folder / film.name)
    return folder


@pytest.fixture
def world(made, tmp_path) -> Path:
    """A reader's own copy of that folder."""
    shutil.copytree(made, tmp_path, symlinks=True, dirs_exist_ok=True)
    return tmp_path


def run(line: str, folder: Path) -> subprocess.CompletedProcess:
    """The line as a shell runs it, made small; in this process where no shell has a part in it: much faster."""
    small = next((more for words, more in SMALL.items() if line.startswith(words)), "")
    if re.search(r"[|&;<>$*?~`(){}#!]", line):
        program = shlex.quote(str(Path(sys.executable).with_name("gof")))
        command = re.sub(r"^gof", program, line) + f" {small}"
        return subprocess.run(["bash", "-c", command], cwd=folder, capture_output=True, text=True, timeout=550)
    words = shlex.split(f"{line} {small}")
    out, errors, before = io.StringIO(), io.StringIO(), Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            status = main(words[1:])
    except SystemExit as e:
        status = e.code
    finally:
        os.chdir(before)
    return subprocess.CompletedProcess(words, status or 0, out.getvalue(), errors.getvalue())


def test_a_command_that_fails_is_seen_to_fail(tmp_path):
    """In this process and in a shell alike, with what it says."""
    for line in ("gof evaluate nothing --dataset nothing", "gof evaluate nothing --dataset nothing; exit $?"):
        done = run(line, tmp_path)
        assert done.returncode == 1 and "nothing" in done.stderr, (line, done)
    assert run("gof evaluate --no-such-option", tmp_path).returncode == 2
    assert run("gof evaluate nothing --dataset nothing", tmp_path).args[0] == "gof", "in this process"


def cases() -> list:
    """Pages with the commands of theirs that are run; those that start Blender are marked."""
    found = []
    for page, lines in pages().items():
        here = [line for line in lines if reason(line) is None]
        if here:
            marks = [pytest.mark.blender] if any(line.startswith(BLENDER) for line in here) else []
            found.append(pytest.param(page, here, id=page.replace(" ", "_"), marks=marks))
    return found


@pytest.mark.long
@pytest.mark.parametrize("page, lines", cases())
def test_what_a_page_prints_runs_in_its_order(page, lines, world):
    for line in lines:
        for made in re.findall(r"^gof (?:generate|ingest|reconstruct) .*--out (\S+)", line):
            shutil.rmtree(world / made, ignore_errors=True)  # of the sample; now the reader makes it
    for line in [*([BEFORE[page]] if page in BEFORE else []), *lines]:
        done = run(line, world)
        assert done.returncode == 0, f"{page}: {line}\n{done.stdout[-1500:]}\n{done.stderr[-1500:]}"


# ---------------------------------------------------------------- what messages name

SOURCES = [*ROOT.glob("gof/**/*.py"), *ROOT.glob("blender_addon/**/*.py")]
SOURCES += [path for path in ROOT.glob("benchmark/**/*.py") if "evidence" not in path.parts]
NAMED = re.compile(rf"\bgof ((?:{'|'.join(sorted(commands()))})(?: [a-z]+)?)((?: [^\s'\"`;,()]+)*)")


def texts(path: Path) -> list[tuple[int, str]]:
    """(line, text) of every string of a file; what is put into it by braces is X."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            words = [part.value if isinstance(part, ast.Constant) else "X" for part in node.values]
            found.append((node.lineno, "".join(map(str, words))))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            found.append((node.lineno, node.value))
    return found


@pytest.mark.checkout
@pytest.mark.long
def test_every_option_that_a_message_names_exists():
    helps: dict[tuple[str, ...], str] = {}
    wrong, seen = [], 0
    for path in SOURCES:
        for line, text in texts(path):
            for name, rest in NAMED.findall(text):
                words = tuple(name.split()) if name.split()[0] in GROUPS else (name.split()[0],)
                options = re.findall(r"(?<!\S)(--[a-z][\w-]*)", f"{name}{rest}")
                if not options or words[0] == "baseline":
                    continue
                if words not in helps:
                    helps[words] = help_of(*words)
                seen += 1
                missing = [o for o in options if not re.search(rf"{re.escape(o)}(?![\w-])", helps[words])]
                wrong += [f"{path.relative_to(ROOT)}:{line}: gof {' '.join(words)} has no {o}" for o in missing]
    assert seen > 30
    assert not wrong, "\n".join(wrong)
