"""The same fire at another rate: what reaches the solver is its step, not the pictures' rate."""

import gzip
from dataclasses import replace
from pathlib import Path

import pytest

from gof_benchmark.generator.blender_process import run_stage
from gof_benchmark.scenes import claim
from gof_blender.pure.clip import Clip
from gof_blender.pure.fires import Domain
from gof_blender.pure.layout import Layout
from gof_blender.pure.rig import Rig
from tests.blender.runs import TOY

HEADER = 400  # bytes of a grid's file in which the time of writing is


@pytest.mark.blender
def test_four_steps_a_frame_and_four_times_the_frames_are_one_fire(tmp_path):
    """Both end at the same step, and every grid of every step is equal to the bit."""
    slow = baked(tmp_path / "slow", clip=Clip(2, 100, 4, steps_per_frame=4))
    fast = baked(tmp_path / "fast", clip=Clip(5, 400, 16))
    assert len(slow) == 21 and slow == fast
    assert any(slow["vel_0021.uni"]), "the gas moves"


@pytest.mark.blender
def test_nothing_of_the_pictures_reaches_the_solver(tmp_path):
    """Other cameras, surroundings, light, quality and further truth: the same velocity, to the bit."""
    clip = Clip(2, 50, 12)
    plain = baked(tmp_path / "plain", clip=clip)
    other = baked(
        tmp_path / "other",
        clip=clip,
        cameras=Rig(count=5, eval_count=1, radius=4.0, roll_deg=0),
        background="cloister",
        fire=replace(TOY.fire, light="sheets", intensity=2.0),
        render=replace(TOY.render, samples=7, percentage=9),
        ground_truth=("grids", "flow", "vdb"),
    )
    assert len(plain) == 14 and plain == other
    assert baked(tmp_path / "seed", clip=clip, seed=TOY.seed + 1) != plain


def baked(folder: Path, **changes) -> dict[str, bytes]:
    """The velocity of every step as the solver has stored it, by the name of its file."""
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    layout = Layout(folder)
    claim(layout, replace(TOY, domain=Domain(resolution=16), **changes))
    run_stage("bake", layout.root)
    grids = {path.name: gzip.decompress(path.read_bytes()) for path in layout.bake.rglob("vel_*.uni")}
    return {name: grid[HEADER:] for name, grid in grids.items()}
