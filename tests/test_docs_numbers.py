"""Numbers of the documents: whoever shows measured ones names beside them the command, or the test, that gives them.

The slow part runs the named evidence scripts at toy size: what a page tells a reader to run does run.
"""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.reconstruct.rising_flame import reconstruct, write_flame
from tests.test_docs import ROOT, evidence_scripts, modules_run_by

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

# Figures with a unit of measurements, scores, and charts that a script draws.
MEASURED = re.compile(r"\d ?(?:dB|ms|us|fps|frames/s|GB|MB|%|m/s|CPU s)(?![\w-])|\d s\b|\d\.\d\d|\bfigures/\w+\.svg")
COMMAND = re.compile(
    r"\bpython -m (?:gof_benchmark|tests)[\w.]+|(?:`|^)gof [a-z]\w*|(?:`|^)make \w+|\btest_\w+", re.MULTILINE
)

NOT_MEASURED = {  # (page, heading): what its figures are
    ("docs/capture.md", "How it tells the time"): "the board's protocol",
    ("docs/formats.md", "Velocity store and grids"): "an example file",
    ("docs/how_real.md", "What real fires do"): "laws from the literature",
    ("docs/renderer.md", "Dr.Jit arrays"): "an example",
    ("docs/renderer.md", "torch, as gsplat"): "limits of the functions",
    ("docs/renderer_inside.md", "How it works"): "limits of the functions",
}


class Section(NamedTuple):
    """A heading, the text below it to the next one, and the text of the headings that it stands under."""

    page: str
    heading: str
    text: str
    above: str

    @property
    def shows_measurements(self) -> bool:
        return bool(MEASURED.search(self.text))

    @property
    def names_command(self) -> bool:
        return bool(COMMAND.search(self.heading + "\n" + self.text) or COMMAND.search(self.above))


def sections(page: Path) -> list[Section]:
    """All sections of a page; the page's own title is above none of them."""
    name, found, open_ = page.relative_to(ROOT).as_posix(), [], []
    fenced = False
    for line in page.read_text(encoding="utf-8").splitlines():
        fenced ^= line.startswith("```")
        heading = None if fenced else re.match(r"(#+) (.*)", line)
        if heading:
            level = len(heading[1])
            open_ = [part for part in open_ if part[0] < level]
            open_.append([level, heading[2], ""])
            found.append([open_[-1], [part for part in open_[:-1] if part[0] > 1]])
        elif open_:
            open_[-1][2] += line + "\n"
    return [Section(name, part[1], part[2], "\n".join(f"{p[1]}\n{p[2]}" for p in parents)) for part, parents in found]


SECTIONS = [section for page in PAGES for section in sections(page)]


def test_sections_are_told_apart(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("# T\n`gof view`\n## A\n1.5 dB\n### B\n12 ms\n```\n# no heading\n```\n## C by `gof report`\n0.25\n")
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    title, a, b, c = sections(page)
    assert [s.heading for s in (title, a, b, c)] == ["T", "A", "B", "C by `gof report`"]
    assert not title.shows_measurements and title.names_command
    assert a.shows_measurements and not a.names_command, "the title's command is nobody else's"
    assert "# no heading" in b.text and b.shows_measurements and not b.names_command
    assert c.shows_measurements and c.names_command
    assert not b._replace(text="three dB, 2.5 flames").shows_measurements


@pytest.mark.checkout
def test_measured_numbers_name_what_prints_them():
    bare = {(s.page, s.heading) for s in SECTIONS if s.shows_measurements and not s.names_command}
    assert sorted(bare - NOT_MEASURED.keys()) == [], "name the command, or the test, beside the figures"


@pytest.mark.checkout
def test_the_list_of_other_numbers_is_short_and_needed():
    bare = {(s.page, s.heading) for s in SECTIONS if s.shows_measurements and not s.names_command}
    assert NOT_MEASURED.keys() - bare == set(), "no longer needed"
    assert len(NOT_MEASURED) <= 12


# ---------------------------------------------------------------- the scripts run

TINY = ("--gaussians", "300", "--iterations", "20", "--voxels", "16")

# Evidence script -> its arguments at toy size. FLAME: a dataset of drawn Gaussians that rise, three cameras of 48x96
# pixels; LATE: the same with clocks that are off; RESULT: a reconstruction of FLAME; OUT: an empty folder.
TOY = {
    "choices": ("FLAME", "--out", "OUT", "--only", "ours", "plates in the dark", *TINY),
    "calibration": ("FLAME",),
    "dve_orders": ("--out", "OUT", "--gaussians", "100", "--samples", "1000"),
    "dve_speed": ("--counts", "1000", "--sizes", "16", "--scipy-up-to", "1000"),
    "hard_cases": ("FLAME",),
    "interval_coverage": ("--repeats", "20"),
    "motion_bounds": ("FLAME",),
    "real_clips": ("FLAME", "--out", "OUT", "--methods", "gof", *TINY),
    "real_motion": ("FLAME",),
    "reconstruct_memory": ("FLAME", "--runs", "96", "300", "16"),
    "render_kernels": ("--quick",),
    "render_lasting": ("--steps", "200", "--gaussians", "200", "--width", "48", "--height", "32", "--native-only"),
    "render_speed": ("--quick",),
    "ring_accuracy": ("--frames", "20", "--only", "as it comes"),
    "scene_model": ("FLAME", "RESULT"),
    "training_step": ("FLAME", "--gaussians", "300", "--steps", "3"),
    "wrong_clocks": ("LATE", "--out", "OUT", "--errors", "0", "1", *TINY),
}

# The others, and why they have no run at toy size.
NOT_AT_TOY_SIZE = {
    "addon_speed": "its size is the claim: 10^6 Gaussians in Blender",
    "baseline_rows": "trains other methods by their own code, which users bring",
    "capture_accuracy": "its pictures are of full size: the marker needs 40 pixels",
    "colmap_points": "structure from motion finds nothing in toy pictures",
    "contact_sheet": "renders a scene by Blender",
    "cost_check": "makes two whole datasets by Blender",
    "effect_costs": "makes a dataset for every effect by Blender",
    "fire_sizes": "bakes six fires by Blender",
    "flame_clock": "needs the paper's clips",
    "flame_looks": "needs the paper's clips",
    "four_ways": "bakes and renders the built-in scenes by Blender",
    "gas_from_below": "bakes two fires by Blender",
    "generated_board": "renders a board by Blender",
    "ingest_memory": "needs ffmpeg; its size is the claim",
    "picture_costs": "renders two dozen pictures by Blender; their size is the claim",
    "looks_sheet": "bakes and renders every scene three times by Blender",
    "noise_truth": "needs two fires baked by Blender; checks/test_motion.py tests its measures",
    "open_sockets": "runs every command, Blender's too",
    "ordinary_footage": "needs ffmpeg and the paper's clips",
    "real_depth": "stereo has nothing to match in toy pictures; checks/test_real_footage.py tests its measures",
    "render_agreement": "has one size; Mitsuba draws it in minutes",
    "render_gpu": "needs an NVIDIA GPU",
    "render_opensplat": "compiles a library that users bring",
    "rise_speed": "so few pixels and frames have no bright structures that climb",
    "share_player": "needs Chromium",
    "tomography": "needs the true light of a generated dataset",
}


def test_every_script_has_a_toy_run_or_a_reason():
    assert TOY.keys() | NOT_AT_TOY_SIZE.keys() == evidence_scripts()
    assert not TOY.keys() & NOT_AT_TOY_SIZE.keys()
    named = {name for page in PAGES for name in modules_run_by(page.read_text(encoding="utf-8"))}
    named = {name.removeprefix("evidence.") for name in named if name.startswith("evidence.")} - {"NAME"}
    assert named <= TOY.keys() | NOT_AT_TOY_SIZE.keys()


@pytest.fixture(scope="session")
def toys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toys")
    flame = write_flame(folder / "flame", frames=10)
    late = write_flame(folder / "late", frames=10, late={1: 0.004, 2: -0.006})
    return {"FLAME": flame, "LATE": late, "RESULT": reconstruct(flame, folder / "result").parent}


@pytest.mark.slow
@pytest.mark.parametrize("name", TOY)
def test_the_script_prints_its_figures_at_toy_size(name, toys, tmp_path):
    places = {**{key: str(path) for key, path in toys.items()}, "OUT": str(tmp_path / "out")}
    arguments = [places.get(word, word) for word in TOY[name]]
    run = subprocess.run(
        [sys.executable, "-m", f"gof_benchmark.evidence.{name}", *arguments],
        capture_output=True,
        text=True,
        timeout=500,
        cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)},
    )
    assert run.returncode == 0, run.stderr[-3000:]
    assert re.search(r"\d\.\d|\| \d+ \|", run.stdout), "it prints figures"
    assert "Traceback" not in run.stderr and "nan" not in run.stdout.lower()
