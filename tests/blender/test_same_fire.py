"""The same fire at another rate: what reaches the solver is its step, not the pictures' rate."""

import gzip
from dataclasses import replace

import pytest

from gof_benchmark.generator.blender_process import run_stage
from gof_benchmark.scenes import claim
from gof_blender.pure.clip import Clip
from gof_blender.pure.fires import Domain
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY

HEADER = 400  # bytes of a grid's file in which the time of writing is


@pytest.mark.blender
def test_four_steps_a_frame_and_four_times_the_frames_are_one_fire(tmp_path):
    """Both end at the same step, and every grid of every step is equal to the bit."""
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    made = []
    for name, clip in (("slow", Clip(2, 100, 4, steps_per_frame=4)), ("fast", Clip(5, 400, 16))):
        layout = Layout(tmp_path / name)
        claim(layout, replace(TOY, clip=clip, domain=Domain(resolution=16)))
        run_stage("bake", layout.root)
        grids = {path.name: gzip.decompress(path.read_bytes()) for path in layout.bake.rglob("vel_*.uni")}
        made.append({name: grid[HEADER:] for name, grid in grids.items()})
    slow, fast = made
    assert len(slow) == 21 and slow == fast
    assert any(slow["vel_0021.uni"]), "the gas moves"
