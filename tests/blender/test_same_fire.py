"""The same spec is the same fire: what reaches the solver is its step, in order, and not the pictures' rate."""

import gzip
import re
import shutil
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.core.fields import VelocitySequence
from gof_benchmark.commands.generate import main as generate_command
from gof_benchmark.generator import graph
from gof_benchmark.generator.blender_process import run_stage
from gof_benchmark.scenes import claim
from gof_blender.core.checked_json import SpecError
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import clock, moving_emitter, wind
from gof_blender.pure.fires import Domain
from gof_blender.pure.layout import Layout
from gof_blender.pure.rig import Rig
from gof_blender.pure.spec import GridFire, SceneSpec
from gof_blender.pure.timing import Clip
from tests.blender.runs import TOY, in_blender

HEADER = 400  # bytes of a grid's file in which the time of writing is


@pytest.mark.blender
def test_four_steps_a_frame_and_four_times_the_frames_are_one_fire(tmp_path):
    """Both end at the same step, and every grid of every step is equal to the bit."""
    slow = baked(tmp_path / "slow", clip=Clip(2, 100, 4, steps_per_frame=4))
    fast = baked(tmp_path / "fast", clip=Clip(5, 400, 16))
    assert len(slow) == 5 and slow == fast  # those that are read; each stands on all before it
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
    assert len(plain) == 2 and plain == other
    assert baked(tmp_path / "seed", clip=clip, seed=TOY.seed + 1) != plain


@pytest.mark.blender
def test_a_longer_clip_begins_as_the_short_one(tmp_path):
    """Gusts and a moving burner included: the steps that two clips share are equal to the bit."""
    fire = replace(TOY.fire, speeds="physical")
    effects = (wind.Settings(gusts=0.5), moving_emitter.Settings())
    short = baked(tmp_path / "short", clip=Clip(4, 50, 12), fire=fire, effects=effects)
    long = baked(tmp_path / "long", clip=Clip(11, 50, 12), fire=fire, effects=effects)
    assert len(long) == len(short) + 7
    assert [name for name, grid in short.items() if long[name] != grid] == []


@pytest.mark.blender
def test_a_fire_of_another_dataset_seen_anew_is_the_dataset_made_from_nothing(tmp_path, monkeypatch):
    """Other cameras, surroundings and samples: pictures and velocity equal to the bit, the first dataset removed."""
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    first = replace(TOY, clip=Clip(3, 60, 14))
    render = replace(TOY.render, samples=2)
    seen_anew = replace(
        first, name="anew", cameras=Rig(count=2, eval_count=1, azimuth_deg=20), background="ground", render=render
    )
    for name, spec in (("first", first), ("anew", seen_anew), ("other", replace(seen_anew, seed=TOY.seed + 1))):
        scene_spec.save(spec, tmp_path / f"{name}.json")
    claim(Layout(tmp_path / "first"), first)
    run_stage("bake", tmp_path / "first")
    with pytest.raises(GofError, match="another fire burns there .seed differ"):
        generate(tmp_path, "other", "other", "--fire-of", str(tmp_path / "first"))
    with pytest.raises(GofError, match="holds no finished bake"):
        generate(tmp_path, "anew", "lent", "--fire-of", str(tmp_path / "nowhere"))
    layout = Layout(tmp_path / "lent")
    claim(layout, seen_anew)
    layout.take_fire_of(Layout(tmp_path / "first"), seen_anew)
    shutil.rmtree(tmp_path / "first")
    learned = []
    monkeypatch.setattr(graph, "learn", lambda spec, cpu_s: learned.append(cpu_s))
    for name in ("lent", "direct"):
        generate(tmp_path, "anew", name)
    assert len(learned) == 1, "a bake that was taken over tells nothing of how long one takes"
    assert not list(layout.hidden.glob("lent*")) and Layout(tmp_path / "direct").bake_marker.is_file()
    pictures = [path.relative_to(layout.root) for path in layout.root.rglob("*.png")]
    assert len(pictures) >= 3 * 3 * 2
    for path in pictures:
        assert (tmp_path / "direct" / path).read_bytes() == (layout.root / path).read_bytes(), path
    shutil.rmtree(layout.hidden)  # which a user may delete
    scene = layout.blend.read_bytes()
    layout.take_fire_of(Layout(tmp_path / "direct"), seen_anew)
    assert layout.blend.read_bytes() == scene and not layout.bake.exists(), "a finished dataset stays as it is"
    lent, direct = (VelocitySequence.open(tmp_path / name / "velocity.zarr") for name in ("lent", "direct"))
    assert np.abs(direct.cells(1)).max() > 0
    for frame in range(3):
        np.testing.assert_array_equal(lent.cells(frame), direct.cells(frame))


def generate(folder: Path, spec: str, out: str, *options: str) -> None:
    assert generate_command([str(folder / f"{spec}.json"), "--out", str(folder / out), *options]) == 0


@pytest.mark.blender
@pytest.mark.parametrize(
    ("effects", "keyed"),
    [
        ((), {"Fire Burner"}),
        ((wind.Settings(gusts=0.5), moving_emitter.Settings()), {"Fire Burner", "Wind"}),
    ],
)
def test_the_solver_waits_for_all_that_is_keyed(tmp_path, effects, keyed):
    """Blender's own graph of a frame: from the keys of whatever the solver reads, a way leads to the solver's step.

    Where none does, Blender's threads may take the step first, with the values of the step before. That happens in few
    bakes, most of them on a busy machine, so that repeating a bake would hardly ever show it.
    """
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    scene_spec.save(replace(TOY, effects=effects), tmp_path / "spec.json")
    in_blender(
        """
        from gof_blender.pure import spec
        from gof_blender.scene import build
        build.scene(spec.load(f"{sys.argv[1]}/spec.json"))
        bpy.context.evaluated_depsgraph_get().debug_relations_graphviz(filepath=f"{sys.argv[1]}/graph.dot")
        """,
        tmp_path,
    )
    names, after = read_graph(tmp_path / "graph.dot")
    step = next(node for node, name in names.items() if name[0] == "Fire Domain" and name[-1] == "MODIFIER(Fluid)")
    keys = {name[0]: node for node, name in names.items() if name[-1] == "ANIMATION_EXIT()"}
    assert set(keys) >= keyed
    read = {names[node][0] for node in names if step in after[node]} - {"Fire Domain"}
    assert read & set(keys) == keyed
    for name in keyed:
        assert step in reached(keys[name], after), name


def read_graph(path: Path) -> tuple[dict[str, tuple[str, ...]], dict[str, set[str]]]:
    """Operations of Blender's graph, as (object, component, operation), and which follow directly upon each."""
    names, after, inside = {}, defaultdict(set), []
    for line in map(str.strip, path.read_text().splitlines()):
        if line.startswith("subgraph"):
            inside.append("")
        elif line == "}" and inside:
            inside.pop()
        elif line.startswith("graph [") and inside:
            inside[-1] = re.sub(r"ID_REF : [A-Z]{2}| \(orig.*", "", re.search(r'label="([^"]*)"', line)[1])
        elif link := re.match(r'"(\d+)" -> "(\d+)"', line):
            after[link[1]].add(link[2])
        elif node := re.match(r'"(\d+)" \[.*label="([^"]+)"', line):
            names[node[1]] = (*inside, node[2])
    return names, after


def reached(node: str, after: dict[str, set[str]]) -> set[str]:
    """All nodes that come after one."""
    found, open_ends = set(), [node]
    while open_ends:
        new = after[open_ends.pop()] - found
        found |= new
        open_ends += new
    return found


def baked(folder: Path, **changes) -> dict[str, bytes]:
    """The velocity of every step as the solver has stored it, by the name of its file."""
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    layout = Layout(folder)
    claim(layout, replace(TOY, domain=Domain(resolution=16), **changes))
    run_stage("bake", layout.root)
    grids = {path.name: gzip.decompress(path.read_bytes()) for path in layout.bake.rglob("vel_*.uni")}
    return {name: grid[HEADER:] for name, grid in grids.items()}


def test_a_rig_whose_clocks_want_steps_that_are_gone_takes_no_fire(tmp_path):
    """A bake keeps the steps that its own cameras see; with other clocks the flame would be missing."""
    theirs = replace(TOY, effects=(clock.Settings(offset_s=0.1),))
    ours = replace(theirs, cameras=replace(theirs.cameras, count=8))
    assert ours.timeline.steps_needed.start < theirs.timeline.steps_needed.start
    other, layout = Layout(tmp_path / "other"), Layout(tmp_path / "ours")
    claim(other, theirs)
    claim(layout, ours)
    other.bake.mkdir(parents=True)
    other.bake_marker.write_text("{}")
    other.blend.touch()
    with pytest.raises(SpecError, match="another fire burns there .fewer steps differ"):
        layout.take_fire_of(other, ours)
    assert not layout.bake.exists()


def test_a_fire_whose_grids_were_solved_again_is_not_taken_over(tmp_path):
    """Its pictures would be of the fire of before, and its velocities of the one of today."""
    grids = tmp_path / "grids"
    grids.mkdir()
    (grids / "fire.json").write_text('{"solved": "monday"}')
    theirs = SceneSpec(name="theirs", fire=GridFire(str(grids)))
    ours = replace(theirs, name="ours", cameras=replace(theirs.cameras, count=5))
    other, layout = Layout(tmp_path / "other"), Layout(tmp_path / "ours")
    claim(other, theirs)
    claim(layout, ours)
    other.bake.mkdir(parents=True)
    (other.bake / "000001.vdb").write_bytes(b"monday")
    other.bake_marker.write_text("{}")
    other.blend.touch()
    (grids / "fire.json").write_text('{"solved": "tuesday, again"}')
    with pytest.raises(SpecError, match="fire.json, which has changed since; bake it again"):
        layout.take_fire_of(other, ours)
    assert not layout.bake.exists()
