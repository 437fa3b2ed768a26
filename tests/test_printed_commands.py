"""Every command that README, `gof --help` and the help of each command print is run as printed, in its order.

What a reader has by then is `gof sample`, and what the commands before made. Sizes are made small (`SMALL`), nothing
else is changed. What is not run stands in `NOT_RUN` with the reason. What errors and notes name exists.
"""

import ast
import contextlib
import importlib
import io
import re
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gof.commands.cli import commands, main
from gof.commands.read import read_options
from gof.core.errors import GofError
from tests.reader import clear, lay_out, not_run_elsewhere, run, tutorials, work_of

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
GROUPS = ("benchmark", "capture", "figure", "study")  # `gof GROUP PART`: each part has options of its own
LINE = re.compile(r"^ *(gof [a-z]+ (?!- ).*?)(?: {3,}.*)?$", re.MULTILINE)  # three blanks, then what it makes

SERVER, HOURS, HARDWARE = "serves pages until it is stopped", "takes hours", "needs the board, or printed targets"
OTHERS, SUITE = "needs other people's code or files", "tests/suite walks this way, with smaller scenes"
NOT_RUN = {  # words that the command begins with: why
    "gof benchmark make": SUITE,
    "gof reconstruct bench/": SUITE,
    "gof benchmark add": SUITE,
    "gof benchmark check": SUITE,
    "gof benchmark score": SUITE,
    "gof capture board": HARDWARE,
    "gof capture calibrate": HARDWARE,
    "gof convert chkpnt30000.pth": OTHERS,
    "gof study generate": HOURS,
    "gof study reconstruct": HOURS,
    "gof study ablations": HOURS,
    "gof view": SERVER,
    "gof ingest a.mp4": OTHERS,
    "gof completion": "writes into the home folder; tests/test_command_line.py runs it",
    "gof demo": "tests/test_demo.py walks this way, with a smaller fire",
    "gof generate ring.json": "tests/blender/test_same_fire.py takes over a fire",
    "gof generate demo --estimate": "measures the machine for minutes",
}
BEFORE = {  # page: what its reader has done before
    "gof unpack": "gof pack data/fire --licence CC0-1.0 --authors A --out .",
    "gof report": "gof evaluate out/fire --dataset data/fire --no-images",
    "README": "gof evaluate out/fire --dataset data/fire --no-images",
}
BLENDER = ("gof demo", "gof generate", "gof import")


@cache
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
    assert len(pages()["README"]) >= 12 and len(pages()["gof"]) >= 5


# ---------------------------------------------------------------- running them


@pytest.fixture(scope="module")
def sample(tmp_path_factory) -> Path:
    return lay_out(tmp_path_factory.mktemp("sample") / "world")


@pytest.fixture
def world(sample, tmp_path) -> Path:
    """A copy for one page."""
    return shutil.copytree(sample, tmp_path / "world", symlinks=True)


FAILING = ("gof evaluate nothing --dataset nothing", "gof evaluate --no-such-option", "false; true")


@pytest.mark.parametrize("line", FAILING)
def test_a_command_that_fails_is_seen_to_fail(line, tmp_path):
    """In this process and in a shell alike."""
    with pytest.raises(AssertionError, match=line.partition(";")[0]):
        run(tmp_path, line)


def cases() -> list:
    """Pages with the commands of theirs that are run, each once; those that start Blender are marked."""
    found, elsewhere = [], tutorials()
    first_and_last = {"gof": -1, "README": 1}  # the loop runs as one; README shows what the helps do
    for page, lines in sorted(pages().items(), key=lambda item: first_and_last.get(item[0], 0)):
        here = [line for line in lines if reason(line) is None]
        here = here if page == "gof" else not_run_elsewhere(here, elsewhere)
        elsewhere |= set(map(work_of, here))
        if here:
            marks = [pytest.mark.blender] if any(line.startswith(BLENDER) for line in here) else []
            found.append(pytest.param(page, here, id=page.replace(" ", "_"), marks=marks))
    return found


def test_every_command_that_is_printed_is_run_or_has_its_reason():
    run_here = {work_of(line) for case in cases() for line in case.values[1]} | tutorials()
    for lines in pages().values():
        for line in lines:
            assert (work_of(line) in run_here) != (reason(line) is not None), line


def test_the_files_that_readme_names_are_in_the_sample(sample):
    """Its commands run under the names of the helps, which the same files have here."""
    names = {word for line in pages()["README"] for word in line.split() if word.startswith("sample/")}
    assert len(names) >= 4
    for name in names:
        assert list(sample.glob(name)), name


@pytest.mark.long
@pytest.mark.parametrize("page, lines", cases())
def test_what_a_page_prints_runs_in_its_order(page, lines, world):
    for line in [*([BEFORE[page]] if page in BEFORE else []), *lines]:
        clear(world, line)
        run(world, line)


# ---------------------------------------------------------------- what messages name

SOURCES = [*ROOT.glob("gof/**/*.py"), *ROOT.glob("blender_addon/**/*.py")]
SOURCES += [path for path in ROOT.glob("benchmark/**/*.py") if "evidence" not in path.parts]
NAMED = re.compile(rf"\bgof ((?:{'|'.join(sorted(commands()))})(?: [a-z]+)?)((?: [^\s'\"`;,()]+)*)")


@cache
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


@cache
def parsers() -> dict[str, type]:
    """The class of options of each command, by the words that call it."""
    found = {}
    for path in SOURCES:
        for config, name in re.findall(r"read_options\((\w+), \"([a-z ]+)\", argv\)", path.read_text(encoding="utf-8")):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            found[name] = getattr(importlib.import_module(re.sub("^benchmark", "gof_benchmark", module)), config)
    return found


def parses(name: str, words: list[str]) -> bool:
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            read_options(parsers()[name], name, words)
        except (SystemExit, GofError):
            return False
    return True


@pytest.mark.checkout
@pytest.mark.long
def test_every_command_line_that_a_message_names_parses():
    """Whole ones, with what they are given; 1 is what stands for a word in capitals: a path, a name and a number."""
    wrong, seen = [], 0
    for path in SOURCES:
        for line, text in texts(path):
            for name, rest in NAMED.findall(text):
                name, *more = [*name.split(), *rest.rstrip(".:").split()]
                if name in GROUPS:
                    name = f"{name} {more.pop(0)}" if more else name
                if name not in parsers() or "--" not in rest or not more or more[0][0] in "-[" or "[--" in rest:
                    continue
                more = [re.sub(r"^(.*=)?([A-Z_]+|\{\w+\})$", r"\g<1>1", word) for word in more if word != "..."]
                tries = [more, [*more, "1"]] if more[-1].startswith("--") else [more]
                seen += 1
                if not any(parses(name, words) for words in tries):
                    wrong.append(f"{path.relative_to(ROOT)}:{line}: gof {name} {' '.join(more)}")
    assert seen > 40
    assert not wrong, "\n".join(wrong)


FOOTAGE = ("ingest", "capture sync", "capture annotate", "capture calibrate", "depth", "background")
PRINTED_BY = {  # a part of the house: the commands that print its messages
    "gof/capture": ("capture board", "capture draw", "capture target", *FOOTAGE),
    "gof/ingest": FOOTAGE,
    "gof/footage": FOOTAGE,
    "gof/reconstruct": ("reconstruct", "background"),
    "gof/render": (),
    "gof/io/importers": (),  # every command that takes a result; only `gof convert` has options for it
    "gof/io": ("convert",),
    "gof/evaluate": ("evaluate", "leaderboard"),
    "gof/look": ("figure compare", "figure modalities", "figure removal", "flow", "report", "share", "video", "view"),
    "gof/dataset": ("pack", "unpack"),
}
ANYWHERE = {"--out", "--json", "--quiet", "--verbose", "--overwrite", "--preset", "--dataset", "--help", "--help-all"}
ANYWHERE |= {"--host", "--duration"}  # one that is gone, and one of another program


@pytest.mark.checkout
@pytest.mark.long
def test_an_option_that_a_message_names_alone_is_one_of_a_command_that_prints_it():
    wrong, seen = [], 0
    for path in SOURCES:
        part = next((p for p in PRINTED_BY if path.relative_to(ROOT).as_posix().startswith(p + "/")), None)
        own = re.search(r"gof/commands/([a-z_]+)\.py", path.as_posix())
        names = PRINTED_BY.get(part, ())
        if own and own[1].replace("_", " ") in parsers():
            part, names = "own", (own[1].replace("_", " "),)
        if part is None:
            continue
        for line, text in texts(path):
            if " " not in text or "\n\n    " in text:
                continue  # a name for the program, or a docstring
            here = [*names, *(name for name in parsers() if f"gof {name}" in text)]
            if text.startswith("--"):
                here.append("convert")  # on what was given; only it has options for all results
            for option in re.findall(r"(?<![\w-])(--[a-z][a-z-]+)", text):
                seen += 1
                has = any(re.search(rf"{option}(?![\w-])", help_of(*name.split())) for name in here)
                if option not in ANYWHERE and not has:
                    wrong.append(f"{path.relative_to(ROOT)}:{line}: {option}, of no command of {here}: {text[:90]!r}")
    assert seen > 100
    assert not wrong, "\n".join(wrong)


def _without_unit(world: Path) -> None:
    """A result of FreeTimeGS's kind that says neither its frames nor its seconds."""
    n = 6
    values = {"means": (n, 3), "velocities": (n, 3), "times": (n, 1), "durations": (n, 1), "scales": (n, 3)}
    arrays = {name: np.full(shape, 0.1, np.float32) for name, shape in values.items()}
    arrays |= {"quats": np.eye(4, dtype=np.float32)[[0] * n], "opacities": np.zeros(n, np.float32)}
    arrays |= {"sh0": np.zeros((n, 1, 3), np.float32), "shN": np.zeros((n, 0, 3), np.float32)}
    np.savez(world / "out/theirs.npz", **arrays)


def _without_number_unit(world: Path) -> None:
    run(world, "gof convert out/fire/result.npz out/plys --frame-time 0.01 --clip 0 0.03 --quiet")
    (world / "out/plys.gof.json").unlink()  # another's folder of PLYs has none


REMEDIES = {  # what has happened: how, the command that stops, and what stands for the words of its message
    "no scores": (None, "report out/fire --dataset data/fire", {"RESULT": "out/fire"}),
    "damaged scores": (
        lambda world: (world / "out/fire/scores.json").write_text("{"),
        "report out/fire --dataset data/fire",
        {"RESULT": "out/fire"},
    ),
    "scores of another version": (
        lambda world: (world / "out/fire/scores.json").write_text('{"schema": "gof-scores", "version": 99}'),
        "report out/fire --dataset data/fire",
        {"RESULT": "out/fire"},
    ),
    "one of a board without scores": (
        None,
        "leaderboard boards/ours out/fire --dataset data/fire --out out/board",
        {"RESULT": "out/fire"},
    ),
    "no unit of time": (
        _without_unit,
        "evaluate out/theirs.npz --dataset data/fire --no-images",
        {"RESULT": "out/theirs.npz", "--time-unit": "--time-unit 0.13"},
    ),
    "no seconds between PLYs": (
        _without_number_unit,
        "evaluate out/plys --dataset data/fire --no-images",
        {"RESULT": "out/plys", "--time-unit": "--time-unit 0.01"},
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("case", REMEDIES)
def test_what_an_error_recommends_mends_it(case, world, monkeypatch, capsys):
    fault, command, words = REMEDIES[case]
    monkeypatch.chdir(world)
    if fault:
        fault(world)
    assert main(command.split()) == 1
    said = capsys.readouterr().err
    remedy = re.findall(r"gof ((?:evaluate|convert) [^(,;'\n]*)", said)[-1].rstrip(". ")
    for word, value in (words | {"DATASET": "data/fire"}).items():
        remedy = re.sub(rf"{word}(?![\w-])", value, remedy)
    if remedy.startswith("evaluate"):
        remedy += " --no-images"
    assert main(remedy.split()) == 0, said
    assert main(command.split()) == 0
