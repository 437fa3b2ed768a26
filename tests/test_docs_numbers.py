"""Measured figures of the documents stand in a file of evidence, which the page quotes (tools/evidence.py).

The slow part runs the evidence scripts at toy size: what a page tells a reader to run does run.
"""

import os
import re
import subprocess
import sys

import pytest

from tests.reconstruct.rising_flame import reconstruct, write_flame
from tests.test_docs import ROOT, evidence_scripts, modules_run_by
from tools.evidence import unquoted

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

BOARD, LIMITS, THEIRS = "the board's protocol", "limits of the program", "figures that their authors publish"
NOT_MEASURED = {  # (page, heading): what its figures are
    ("docs/baselines.md", "4DGS of Wu"): LIMITS,
    ("docs/benchmark.md", "How the board ranks"): LIMITS,
    ("docs/benchmark.md", "What is checked"): LIMITS,
    ("docs/capture.md", "A RocSync board"): BOARD,
    ("docs/capture.md", "Filming"): BOARD,
    ("docs/capture.md", "How it tells the time"): BOARD,
    ("docs/capture.md", "The LED board: film, synchronise, calibrate"): BOARD,
    ("docs/capture.md", "When a take is not in order"): LIMITS,
    ("docs/capture_board.md", "Mount it"): BOARD,
    ("docs/formats.md", "Motion of pixels"): LIMITS,
    ("docs/formats.md", "OpenUSD"): "a version",
    ("docs/how_real.md", "What real fires do"): THEIRS,
    ("docs/importers.md", "My own method"): "an example",
    ("docs/ingest.md", "Difficult footage: `gof ingest`"): LIMITS,
    ("docs/ingest.md", "Everyday footage"): LIMITS,
    ("docs/ingest.md", "The authors' 17 scenes"): THEIRS,
    ("docs/paper.md", "The paper's method here"): THEIRS,
    ("docs/paper.md", "What is public"): THEIRS,
    ("docs/reliability.md", "Cameras, clocks and backgrounds that cannot be right"): LIMITS,
    ("docs/reliability.md", "Memory"): LIMITS,
    ("docs/renderer.md", "Odd cases"): LIMITS,
    ("docs/renderer.md", "torch, as gsplat"): LIMITS,
    ("docs/renderer_inside.md", "How it works"): LIMITS,
    ("docs/scores.md", "Further scores"): LIMITS,
    ("docs/scores.md", "Picture scores"): LIMITS,
    ("docs/scores.md", "The authors' six figures"): THEIRS,
    ("docs/tutorials/score.md", "3 Score it"): "of the output above it",
}


@pytest.mark.checkout
def test_measured_figures_quote_their_file():
    bare = {
        (page.relative_to(ROOT).as_posix(), heading) for page in PAGES for heading in unquoted(page.read_text("utf-8"))
    }
    assert sorted(bare - NOT_MEASURED.keys()) == [], "quote evidence/NAME.json (tools/evidence.py), or leave them out"
    assert sorted(NOT_MEASURED.keys() - bare) == [], "no longer needed"


# ---------------------------------------------------------------- the scripts run

TINY = ("--gaussians", "300", "--iterations", "20", "--voxels", "16")

# Evidence script -> its arguments at toy size. FLAME: a dataset of drawn Gaussians that rise, three cameras of 48x96
# pixels; LATE: the same with clocks that are off; RESULT: a reconstruction of FLAME; OUT: an empty folder.
TOY = {
    "choices": ("FLAME", "--out", "OUT", "--only", "ours", "plates in the dark", *TINY),
    "calibration": ("FLAME",),
    "dve_orders": ("--out", "OUT", "--gaussians", "100", "--samples", "1000"),
    "dve_speed": ("--counts", "1000", "--sizes", "16", "--scipy-up-to", "1000"),
    "format_losses": ("RESULT",),
    "hard_cases": ("FLAME",),
    "held_out_camera": ("FLAME", "--out", "OUT", "--preset", "toy", "--steps", "20"),
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
    "few_cameras": "needs views from all around",
    "fire_sizes": "bakes six fires by Blender",
    "flame_clock": "needs the paper's clips",
    "flame_looks": "needs the paper's clips",
    "four_ways": "bakes and renders the built-in scenes by Blender",
    "gas_from_below": "bakes two fires by Blender",
    "generated_board": "renders a board by Blender",
    "into_room": "needs a fire that lights its room; tests/io/test_into_room.py has its measure in closed form",
    "ingest_memory": "needs ffmpeg; its size is the claim",
    "picture_costs": "renders two dozen pictures by Blender; their size is the claim",
    "film_school": "renders a fire three times by Blender",
    "looks_sheet": "bakes and renders every scene three times by Blender",
    "noise_truth": "needs two fires baked by Blender; checks/test_motion.py tests its measures",
    "open_sockets": "runs every command, Blender's too",
    "ordinary_footage": "needs ffmpeg and the paper's clips",
    "presets": "measures this machine by Blender; checks/test_presets.py tests its rows",
    "render_agreement": "has one size; Mitsuba draws it in minutes",
    "render_gpu": "needs an NVIDIA GPU",
    "render_opensplat": "compiles a library that users bring",
    "rise_speed": "so few pixels and frames have no bright structures that climb",
    "run_scores": "reads finished scores; checks/test_run_scores.py tests its figures",
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
