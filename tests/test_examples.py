"""Every command block of README and docs/ runs as printed, page by page and in the order of the page.

What a reader has by then is `gof sample` (tests/reader.py), and what the blocks before made. What is not run stands in
`NOT_RUN` with the reason. The tutorials run in tests/test_site.py.
"""

import contextlib
import io
import re
import shutil
from pathlib import Path

import pytest

from gof.commands.cli import main as gof
from tests import test_printed_commands as printed
from tests.reader import clear, lay_out, not_run_elsewhere, run, work_of

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?:\$ )?(?:gof|python|make|blender) .*$", re.MULTILINE)
GROUPS = ("capture", "figure", "study", "benchmark")  # `gof GROUP WORK`: each work has options of its own
OTHERS, HOURS = "needs other people's code", "takes hours"
HARDWARE = "needs the LED board or its microcontroller"
NOT_RUN = {  # (page, words that the example begins with): why
    ("README.md", "make demo"): "sets up a machine: run before every release",
    ("install.md", "make setup"): "sets up a machine: run before every release",
    ("baselines.md", "gof baseline [--method wu] [--curve"): OTHERS,
    ("baselines.md", "python -m gof_benchmark.views.shrunk"): OTHERS,
    ("baselines.md", "gof baseline --method wu --curve"): OTHERS,
    ("baselines.md", "gof baseline --method yang"): OTHERS,
    ("baselines.md", "gof baseline --method grid4d"): OTHERS,
    ("baselines.md", "python FreeTimeGsVanilla"): OTHERS,
    ("baselines.md", "python -m gof_benchmark.evidence.baseline_rows"): OTHERS + ", and hours",
    ("benchmark.md", "gof benchmark list"): HOURS + "; tests/suite walks the same way at toy size",
    ("capture.md", "gof capture target"): HARDWARE + " and a printed target; tests/capture films synthetic ones",
    ("capture_board.md", ". $IDF_PATH"): HARDWARE,
    ("capture_board.md", "$ firmware/build/emulator"): "needs a compiled emulator; tests/firmware talks to it",
    ("cluster.md", "#!/bin/bash"): "needs a cluster; tests/test_cluster.py has one of two processes",
    ("cluster.md", "from pathlib"): "needs a cluster; tests/test_cluster.py has one of two processes",
    ("how_real.md", "python -m gof_benchmark.fires"): HOURS,
    ("ingest.md", "gof ingest data/hf"): "needs a published data set",
    ("renderer.md", "import drjit"): "names every call with placeholders; tests/render makes each of them",
}
SAID = {  # page: words that stand for the reader's own files
    "importers.md": {
        "RESULT": "mine.npz",
        "DATASET": "data/fire",
        "CAMERAS": "data/fire/dataset.json",
        "model/chkpnt30000.pth": "mine.npz",  # a checkpoint of another method
    },
    "scores.md": {
        "RESULT": "mine.npz",
        "evaluate result.npz": "evaluate mine.npz",
        "DATASET": "data/fire",
        "METHOD": "again",
    },
}
START = """
import numpy as np
from gof.dataset import Dataset
from gof.core.gaussians import TransientGaussians
dataset = Dataset.open("data/fire")
gaussians = TransientGaussians.load("boards/theirs/result.npz")
camera, time_s, field = dataset.cameras[0], 0.12, dataset.velocity.at(0.12)
points = np.zeros((4, 3))
"""
BEFORE = {  # (page, words that a block begins with): what the reader has already
    ("renderer.md", "from gof.render import rasterize"): """
import torch
means, quats, scales = torch.rand(9, 3), torch.rand(9, 4), torch.full((9, 3), 0.1)
opacities, colors, width, height = torch.rand(9), torch.rand(9, 3), 32, 24
viewmats, Ks = torch.eye(4)[None], torch.tensor([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]])
""",
    ("benchmark.md", "gof pack"): "mkdir -p bench/standard; cp -r data/fire bench/standard/jet\n",
    # the other clips of the rig, and this one's dataset
    ("ingest.md", "gof ingest b/cam"): "gof ingest cam_?.mp4 --out data/a --times 60 --fov 23 --marker-mm 60\n"
    "for f in a b c; do mkdir $f; cp cam_?.mp4 $f; done\n",
}

pytestmark = pytest.mark.checkout


def examples() -> list[tuple[str, str, str]]:
    """(page, language, text) of all fenced blocks that are commands or Python."""
    found = []
    for page in PAGES:
        for language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            if language in ("bash", "python") or (not language and COMMAND.search(text)):
                found.append((page.name, language or "bash", text))
    return found


def reason(page: str, text: str) -> str | None:
    return next((why for (of, words), why in NOT_RUN.items() if of == page and text.startswith(words)), None)


def is_listing(page: str, text: str) -> bool:
    """A diagram or an output in which some line looks like a command."""
    return not COMMAND.match(text) and not text.startswith(("#", ".", "from", "import"))


def blocks() -> dict[str, list[tuple[str, str]]]:
    """(language, text) of the blocks that are run, by their page; without commands that run as those of a help."""
    found: dict[str, list[tuple[str, str]]] = {}
    for page, language, text in examples():
        if reason(page, text) is None and not is_listing(page, text):
            found.setdefault(page, []).append((language, text))
    in_helps = {work_of(line) for case in printed.cases() for line in case.values[1]}
    return {page: left for page, those in found.items() if (left := _without(those, in_helps))}


def _without(blocks: list[tuple[str, str]], elsewhere: set[str]) -> list[tuple[str, str]]:
    commands = [line.split(" #")[0].rstrip() for _, text in blocks for line in text.splitlines()]
    kept = set(not_run_elsewhere(commands, elsewhere))
    found = []
    for language, text in blocks:
        lines = [line for line in text.splitlines(keepends=True) if line.split(" #")[0].rstrip() in kept]
        if any(line.strip() for line in lines):
            found.append((language, "".join(lines)))
    return found


def test_what_is_not_run_is_there_and_examples_are_found():
    texts = [(page, text) for page, _, text in examples()]
    for page, words in NOT_RUN:
        assert any(of == page and text.startswith(words) for of, text in texts), f"{page} has no example {words!r}"
    assert sum(map(len, blocks().values())) >= 25


@pytest.mark.long
def test_every_option_that_an_example_names_exists():
    helps: dict[str, str] = {}
    for page, _, text in examples():
        for line in re.findall(r"^(?:\$ )?gof (.*)$", text, re.MULTILINE):
            words = line.split("#")[0].split()
            name = " ".join(words[: 2 if words[0] in GROUPS else 1])
            if words[0] == "baseline" or not re.fullmatch(r"[a-z -]+", name):
                continue  # behind its own options stand those of other people's code
            if name not in helps:
                printed = io.StringIO()
                with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
                    gof([*name.split(), "--help-all"])
                helps[name] = printed.getvalue()
            for option in re.findall(r"(?<!\S)(--[a-z][\w-]*)", line.split("#")[0]):
                assert option in helps[name], f"{page}: gof {name} has no {option}"


# ---------------------------------------------------------------- running them


@pytest.fixture(scope="module")
def sample(tmp_path_factory) -> Path:
    folder = lay_out(tmp_path_factory.mktemp("sample") / "world")
    shutil.copyfile(folder / "boards/theirs/result.npz", folder / "mine.npz")
    shutil.copytree(folder / "boards/theirs", folder / "boards/mine")
    return folder


@pytest.fixture
def world(sample, tmp_path) -> Path:
    """A copy for one page."""
    return shutil.copytree(sample, tmp_path / "world", symlinks=True)


def pages() -> list:
    """Pages with blocks; those that need Blender's library are marked."""
    return [pytest.param(page, marks=[pytest.mark.blender] if page == "scenes.md" else []) for page in blocks()]


@pytest.mark.long
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("page", pages())
def test_the_blocks_of_a_page_run_in_its_order(page, world):
    for language, text in blocks()[page]:
        begun = next((more for (of, words), more in BEFORE.items() if of == page and text.startswith(words)), "")
        for words, instead in SAID.get(page, {}).items():
            text = text.replace(words, instead)
        clear(world, text)
        if begun and language == "bash":
            run(world, begun)
            begun = ""
        run(world, (START if language == "python" else "") + begun + text, language)
