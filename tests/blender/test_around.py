"""Cameras all around a fire: where they stand, of which frames they have pictures, and what they do not change."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from gof_blender.core.checked_json import SpecError
from gof_blender.pure.plausibility import findings
from gof_blender.pure.rig import Pose, Rig, positions, role_of, seen
from gof_blender.pure.spec import SceneSpec, frames_around
from gof_blender.pure.timing import Clip

RIG = Rig(count=2, eval_count=1, around_frames=2, arc_deg=40, azimuth_deg=-90, radius=2, height=1, look_at=(1, 0, 0.5))


def test_they_stand_every_45_degrees_and_above():
    places = positions(RIG)[3:]
    expected = [(1, -2), (1 + 2**0.5, -(2**0.5)), (3, 0), (1 + 2**0.5, 2**0.5), (1, 2)]  # by hand
    assert places[:5, :2] == pytest.approx(np.array(expected), abs=1e-9) and (places[:8, 2] == 1).all()
    assert places[8] == pytest.approx([1, 0, 0.5 + (2**2 + 0.5**2) ** 0.5], abs=0.03), "as far away, above"
    assert seen(RIG, np.array([[1.0, 0.0, 0.5]])).all(), "all look at the fire"
    assert [role_of(name) for name in RIG.names] == ["train"] * 2 + ["eval"] + ["around"] * 9


def test_they_follow_cameras_that_were_placed():
    """Two cameras on +X at 3 m: the first around stands between them."""
    level = Pose((3.0, 0.5, 1.0), (0.5, 0.5, 0.5, 0.5)), Pose((3.0, -0.5, 1.0), (0.5, 0.5, 0.5, 0.5))
    rig = Rig(count=2, around_frames=1, placed=level, look_at=(0, 0, 1))
    distance = (3**2 + 0.5**2) ** 0.5
    assert positions(rig)[2] == pytest.approx([distance, 0, 1]) and positions(rig)[4] == pytest.approx([0, distance, 1])


def test_they_see_a_few_frames_held_out_ones_first():
    assert frames_around(36, 4) == (4, 12, 20, 28), "every 8th frame from the fifth on is held out"
    assert frames_around(36, 2) == (12, 28) and frames_around(8, 2) == (2, 6) and frames_around(8, 0) == ()
    spec = SceneSpec("fire", clip=Clip(frames=36, warm_up_frames=30), cameras=RIG)
    assert len(spec.pictures) == 36 * 3 + 9 * 2 and list(spec.pictures) == sorted(spec.pictures)
    assert {frame for frame, camera in spec.pictures if camera >= 3} == {12, 28}


def test_the_others_are_where_they_were():
    alone = replace(RIG, around_frames=0)
    assert (positions(alone) == positions(RIG)[:3]).all() and alone.names == RIG.names[:3]


def test_more_frames_than_the_clip_has_are_refused():
    with pytest.raises(SpecError, match="cameras.around_frames must be at most the clip's 4 frames"):
        SceneSpec("fire", clip=Clip(frames=4, warm_up_frames=30), cameras=replace(RIG, around_frames=5))
    with pytest.raises(SpecError, match="cameras.around_frames must be 0 or more"):
        replace(RIG, around_frames=-1)


def test_they_stand_behind_a_wall_where_the_others_may_not():
    spec = SceneSpec("fire", clip=Clip(warm_up_frames=30), cameras=Rig(around_frames=2), background="workshop")
    assert [str(f) for f in findings(spec) if "behind" in f.text] == []
    behind = replace(spec, cameras=replace(spec.cameras, azimuth_deg=90))
    assert {f.text.split()[1] for f in findings(behind) if "behind" in f.text} >= {"cam_1"}


def test_they_see_through_what_is_nearer_than_the_fires_box():
    """A camera at y = 3 that looks along -y at a box which ends at y = 0.4; one among those given sees all."""
    pytest.importorskip("bpy")
    code = """
import bpy, sys
from gof_blender.pure.rig import Rig
from gof_blender.pure.spec import SceneSpec
from gof_blender.pure.fires import Domain
from gof_blender.scene import rig
spec = SceneSpec("fire", domain=Domain(min=(-0.4, -0.4, 0.0), size=(0.8, 0.8, 1.6)),
                 cameras=Rig(count=1, radius=3, height=0.5, look_at=(0, 0, 0.5), azimuth_deg=-90, around_frames=1))
rig.build(spec, bpy.context.scene.collection)
print("near", *(bpy.data.cameras[name].clip_start for name in ("cam_0", "around_180")))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    near = done.stdout.partition("near ")[2].split()
    assert list(map(float, near)) == pytest.approx([0.05, 2.6], abs=1e-4), done.stderr
