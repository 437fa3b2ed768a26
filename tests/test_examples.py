"""Every example of README and docs/: run as it is written on a small fire, or named here with the reason why not.

The tutorials run in tests/test_site.py; the options of all commands exist, also of those that are not run.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.core.fields import VelocityField
from gof.core.gaussians import TransientGaussians
from tests.conftest import arc, write_dataset

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?:\$ )?(?:gof|python|make|blender) .*$", re.MULTILINE)
GROUPS = ("capture", "figure", "study", "benchmark")  # `gof GROUP WORK`: each work has options of its own
BLENDER, OTHERS, HOURS = (
    "needs Blender's window or an add-on installed in it",
    "needs other people's code",
    "takes hours",
)
HARDWARE = "needs the LED board or its microcontroller"
NOT_RUN = {  # (page, words that the example begins with): why
    ("README.md", "make demo"): "sets up a machine: run before every release",
    ("addon.md", "$ blender"): BLENDER,
    ("addon.md", "# blender"): BLENDER,
    ("baselines.md", "gof baseline --method wu [--curve"): OTHERS,
    ("baselines.md", "python -m gof_benchmark.views.shrunk"): OTHERS,
    ("baselines.md", "gof baseline --method wu --curve"): OTHERS,
    ("baselines.md", "gof baseline --method yang"): OTHERS,
    ("baselines.md", "python FreeTimeGsVanilla"): OTHERS,
    ("baselines.md", "python -m gof_benchmark.evidence.baseline_rows"): OTHERS + ", and hours",
    ("benchmark.md", "gof benchmark list"): HOURS + "; tests/suite walks the same way at toy size",
    ("benchmark.md", "gof pack"): "packs what the commands above it made; tests/test_pack.py packs and unpacks",
    ("capture.md", "gof capture target"): HARDWARE + " and a printed target; tests/capture films synthetic ones",
    ("capture.md", "gof capture sync"): "needs films of a RocSync board; tests/capture films synthetic ones",
    ("capture_board.md", ". $IDF_PATH"): HARDWARE,
    ("capture_board.md", "$ firmware/build/emulator"): "needs a compiled emulator; tests/firmware talks to it",
    ("capture_board.md", "$ make -C firmware"): "a C compiler's run; tests/firmware makes it",
    ("cluster.md", "#!/bin/bash"): "needs a cluster; tests/test_cluster.py has one of two processes",
    ("cluster.md", "from pathlib"): "needs a cluster; tests/test_cluster.py has one of two processes",
    ("how_real.md", "python -m gof_benchmark.fires"): HOURS,
    ("ingest.md", "gof capture sync"): "needs films of a fire; tests/ingest films small ones",
    ("ingest.md", "gof ingest b/cam"): "needs films of two fires; tests/ingest films small ones",
    ("ingest.md", "gof ingest data/hf"): "needs a published data set",
    ("ingest.md", "gof background"): "thousands of steps; tests/reconstruct makes small ones",
    (
        "leaderboard.md",
        "gof depth data/fire",
    ): "stereo finds nothing in noise; tests/ingest/test_frame_depth.py has texture",
    ("renderer.md", "import drjit"): "names every call with placeholders; tests/render makes each of them",
}
SAID = {  # page: words that stand for the reader's own files
    "dve.md": {"DATASET": "data/fire", "result.npz": "mine.npz"},
    "importers.md": {
        "RESULT": "mine.npz",
        "DATASET": "data/fire",
        "CAMERAS": "data/fire/dataset.json",
        "out.npz | out.ply | out.ftgs.ply | out.glb | out.spz | out.sog | FOLDER": "out.glb",
    },
    "leaderboard.md": {"RESULT": "mine.npz", "DATASET": "data/fire", "METHOD": "again"},
}
START = """
import numpy as np
from gof.dataset import Dataset
from gof.core.gaussians import TransientGaussians
dataset = Dataset.open("data/fire")
gaussians = TransientGaussians.load("flame.npz")
camera, time_s, field = dataset.cameras[0], 0.12, dataset.velocity.at(0.12)
points = np.zeros((4, 3))
"""
BEFORE = {  # (page, words it begins with): what the reader has already
    (
        "importers.md",
        "from gof.io.importers",
    ): 'import shutil, os; os.makedirs("model"); shutil.copy("flame.npz", "model/flame.npz")\n',
    ("renderer.md", "from gof.render import rasterize"): """
import torch
means, quats, scales = torch.rand(9, 3), torch.rand(9, 4), torch.full((9, 3), 0.1)
opacities, colors, width, height = torch.rand(9), torch.rand(9, 3), 32, 24
viewmats, Ks = torch.eye(4)[None], torch.tensor([[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]])
""",
}
INSTEAD = {("importers.md", "model/chkpnt30000.pth"): "model/flame.npz"}  # a checkpoint of another method

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


RUN = [e for e in examples() if reason(e[0], e[2]) is None and not is_listing(e[0], e[2])]


def test_what_is_not_run_is_there_and_examples_are_found():
    texts = [(page, text) for page, _, text in examples()]
    for page, words in NOT_RUN:
        assert any(of == page and text.startswith(words) for of, text in texts), f"{page} has no example {words!r}"
    assert len(RUN) >= 12


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
def world(tmp_path_factory) -> Path:
    """A small fire with true velocity, a reconstruction of it, and a result of another method."""
    from gof.render import render

    folder = tmp_path_factory.mktemp("world")
    rng = np.random.default_rng(2)
    n, times = 300, 0.01 * np.arange(36)
    flame = TransientGaussians(
        position=rng.normal([0, 0, 0.9], [0.1, 0.1, 0.25], (n, 3)),
        velocity=np.tile([0.0, 0.0, 1.5], (n, 1)),
        t_mu=rng.uniform(0, 0.35, n),
        t_sigma=np.full(n, 0.04),
        scale=np.full((n, 3), 0.04),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.5),
        color=rng.uniform([0.8, 0.3, 0.0], [1.0, 0.6, 0.2], (n, 3)),
        dynamic=np.ones(n, bool),
    )
    cameras = arc(3)
    plates = np.full((3, 64, 36, 3), 0.1) + 0.02 * rng.random((3, 64, 36, 3))
    images = [[render(flame, c, t, background=p)["color"] for c, p in zip(cameras, plates, strict=True)] for t in times]
    up = np.tile(np.array([0, 0, 1.5]), (20, 20, 24, 1))
    fields = [VelocityField.from_array(up, (-1, -1, -0.5), 0.125, t) for t in times]
    masks = np.abs(np.array(images) - plates).max(-1) > 0.05
    held_out = [k for k in range(36) if k % 8 == 4]
    write_dataset(folder / "data/fire", cameras, images, plates, times, fields, masks, held_out)
    flame.save(folder / "flame.npz")
    flame.save(folder / "mine.npz")
    (folder / "out").mkdir()
    flame.save(folder / "out/other.ply")
    run(folder, "bash", "gof reconstruct data/fire --steps 20 --gaussians 300 --voxels 24 --out out/fire")
    (folder / "out/demo").mkdir()
    (folder / "out/demo/dataset").symlink_to(folder / "data/fire")
    (folder / "out/demo/reconstruct").symlink_to(folder / "out/fire")
    run(folder, "bash", "gof evaluate mine.npz --dataset data/fire --out boards/mine")
    return folder


def run(folder: Path, language: str, text: str) -> str:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "PYTHONPATH": os.environ.get("PYTHONPATH", str(ROOT))}
    command = ["bash", "-ec", text] if language == "bash" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, f"{text}\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(3600)  # the first one also makes the world
@pytest.mark.parametrize("page, language, text", RUN, ids=lambda value: re.sub(r"\W+", "_", value)[:40])
def test_an_example_runs_as_it_is_written(page, language, text, world):
    for words, instead in SAID.get(page, {}).items():
        text = text.replace(words, instead)
    for (of, words), instead in INSTEAD.items():
        text = text.replace(words, instead) if of == page else text
    if language == "python":
        begun = next((code for (of, words), code in BEFORE.items() if of == page and text.startswith(words)), "")
        text = START + begun + text
    run(world, language, text)
