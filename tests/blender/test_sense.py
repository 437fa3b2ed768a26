"""Scenes whose parts do not make sense together are refused before the start, with the number that would be right."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.errors import GofError
from gof.core.fire import FireDescription, Hearth
from gof_benchmark.commands import generate
from gof_benchmark.fires import __file__ as FIRES
from gof_benchmark.generator import blender_process
from gof_benchmark.scenes import FOLDER as SCENES
from gof_benchmark.solvers.grids import FireFrame, write_fire
from gof_blender.core.checked_json import SpecError
from gof_blender.pure import cost_model, plausibility
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import moving_emitter, obstacles
from gof_blender.pure.fires import Domain, Fire, GridFire
from gof_blender.pure.layout import Layout
from gof_blender.pure.rig import Pose, Rig, positions, seen
from gof_blender.pure.spec import BlendFile, Clip, Display, Render, SceneSpec
from tests.blender.runs import in_blender

PLAIN = SceneSpec("plain", background="studio")
POOL = replace(  # the review's: 4 m across in a domain of 12 m
    PLAIN,
    domain=Domain((-4, -4, 0), (8, 8, 12)),
    fire=Fire(position=(0, 0, 0.4), radius=2.0),
    cameras=Rig(radius=22.0, height=4.0, look_at=(0, 0, 4)),
)


def fatal(spec: SceneSpec) -> str:
    return "; ".join(finding.text for finding in plausibility.findings(spec) if finding.fatal)


def hints(spec: SceneSpec) -> str:
    return "; ".join(finding.text for finding in plausibility.findings(spec) if not finding.fatal)


def test_scenes_and_fires_of_ours_make_sense():
    from pathlib import Path

    paths = [*SCENES.glob("*/spec.json"), *Path(FIRES).parent.glob("*/*.json")]
    specs = [scene_spec.load(path) for path in paths]
    ours = [spec for spec in specs if spec.domain is not None]
    assert len(ours) > 25 and not [(spec.name, fatal(spec)) for spec in ours if fatal(spec)]


def test_a_burner_that_the_solver_cannot_see():
    wide = replace(PLAIN, domain=Domain((-12, -12, 0), (24, 24, 48)), fire=Fire(radius=0.005, position=(0, 0, 0.1)))
    text = fatal(wide)
    assert "a burner of 1 cm in cells of 75 cm" in text
    right = float(re.search(r"make fire.radius ([0-9.]+)", text)[1])
    assert not fatal(replace(wide, fire=Fire(radius=right, position=(0, 0, 1.5)), cameras=Rig(radius=20, height=4)))
    coarse = replace(PLAIN, fire=Fire(radius=0.02), domain=Domain(resolution=64))
    assert not fatal(coarse) and "only 1.6 cells across" in hints(coarse)
    finer = int(re.search(r"domain.resolution (\d+)", hints(coarse))[1])
    assert "cells" not in hints(replace(coarse, domain=Domain(resolution=finer)))
    assert "cells" in hints(replace(coarse, domain=Domain(resolution=finer - 1)))


def test_obstacles_belong_into_the_domain_and_not_on_the_burner():
    def having(**changes):
        return replace(PLAIN, effects=(obstacles.Settings((replace(obstacles.Obstacle(), **changes),)),))

    assert "(100, 100, 100) is outside the domain, (-0.4, -0.4, 0) to (0.4, 0.4, 1.6) m" in fatal(
        having(position=(100.0, 100.0, 100.0))
    )
    assert "stands on the burner" in fatal(having(position=(0.0, 0.0, 0.12)))
    assert not fatal(having()) and "2.0 cells; gas leaks through less than 3, which is 0.075 m" in hints(
        having(size=(0.3, 0.3, 0.05))
    )


def test_a_burner_swings_inside_the_domain():
    assert "may reach 0.27 m" in fatal(replace(PLAIN, effects=(moving_emitter.Settings(reach=0.5),)))
    assert not fatal(replace(PLAIN, effects=(moving_emitter.Settings(reach=0.26),)))


def test_cameras_stand_outside_the_fire_and_see_it():
    assert "cam_0, cam_1, cam_2 in the fire at (0, 0, 0.12); go more than 19.5 cm" in fatal(
        replace(PLAIN, cameras=Rig(radius=0.1, height=0.5))
    )
    assert "cam_0 at (0, -0.3, 0.5) is in the domain" in hints(
        replace(PLAIN, cameras=Rig(count=1, radius=0.3, height=0.5))
    )
    away = Rig(count=1, placed=(Pose((0.0, -3.0, 0.8), (0.0, 0.0, 0.70710678, 0.70710678)),))  # looks along -y
    assert "is not in the picture of cam_0" in fatal(replace(PLAIN, cameras=away))
    there = Rig(count=1, placed=(Pose((0.0, -3.0, 0.8), (0.70710678, 0.70710678, 0.0, 0.0)),))
    assert not fatal(replace(PLAIN, cameras=there))
    assert "cameras.focal_mm" in hints(replace(PLAIN, cameras=Rig(focal_mm=5), render=Render(percentage=12)))


@pytest.mark.parametrize("roll", [0, 90])
def test_what_a_camera_sees_is_what_the_library_projects(roll):
    """Against the pinhole model of `gof.core.cameras`, for cameras on the arc and the same ones placed by hand."""
    rig = Rig(count=3, eval_count=1, roll_deg=roll)
    width, height = (720, 1280) if roll else (1280, 720)
    points = np.random.default_rng(0).uniform(-2.5, 2.5, (400, 3))
    found = seen(rig, points)
    for index, place in enumerate(positions(rig)):
        forward = np.array(rig.look_at) - place
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ place
        focal = 50 / 36 * 1280
        camera = Camera("c", width, height, [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], pose)
        pixel, depth = camera.project(points)
        inside = (depth > 0) & (pixel >= 0).all(1) & (pixel <= [width, height]).all(1)
        np.testing.assert_array_equal(found[index], inside)


def test_rooms_refuse_what_does_not_fit_and_the_studio_grows():
    workshop = replace(POOL, background="workshop")
    assert "the shelves of the workshop stand at y = 1.4: they would be in the fire" in fatal(workshop)
    assert not fatal(POOL) and plausibility.studio_scale(PLAIN) == 1.0
    scale = plausibility.studio_scale(POOL)
    cameras = positions(POOL.cameras)
    assert 1.95 * scale > 4 and 4 * scale > abs(cameras[:, :2]).max() and 5 * scale > 12
    assert "behind the shelves" in fatal(replace(PLAIN, background="workshop", cameras=Rig(azimuth_deg=90.0)))
    assert "below the floor" in fatal(replace(PLAIN, cameras=Rig(height=-0.2)))
    under = replace(PLAIN, domain=Domain((-0.4, -0.4, -0.3), (0.8, 0.8, 1.6)))
    assert "reaches 30 cm below the floor" in fatal(under)


@pytest.mark.parametrize(
    ("hearths", "thing", "wide_m"),
    [
        ((), "whole box of the grids", 0.3),
        (((0.1, 0.0),), "hearth of the grids", 0.1),
        (((0.1, -0.05), (0.1, 0.05)), "circle around the grids' 2 hearths", 0.2),
    ],
)
def test_a_note_on_grids_names_what_they_have(tmp_path, hearths, thing, wide_m):
    """Grids bring hearths or none: the note on small pictures speaks of those, or of the box, and of no burner."""
    grid, cell = (6, 8, 10), 0.05
    matrix = np.diag([cell, cell, cell, 1.0])
    described = tuple(Hearth(1.0, across, (x, 0.0, 0.0), 0.1) for across, x in hearths)
    about = FireDescription("far", "none", (0.0, 0.1), "none", hearths=described)
    still = np.zeros((*grid, 3), np.float32)
    write_fire(tmp_path / "far", about, matrix, lambda k: FireFrame(still, still))
    distance, pixels = 20.0, 64
    rig = Rig(count=1, eval_count=0, radius=distance, look_at=(0, 0, 0.2), sensor_px=(pixels, pixels), roll_deg=0)
    fire = GridFire(str(tmp_path / "far"), position=(0.0, 0.0, 0.1))
    clip = Clip(frames=2, fps=100.0, warm_up_frames=0)
    spec = replace(PLAIN, domain=None, fire=fire, cameras=rig, clip=clip, render=Render(100), effects=())
    note = hints(spec)
    assert f"the {thing} is" in note and "burner" not in note
    found = float(re.search(r"is ([\d.]+) pixels across", note)[1])
    assert found == pytest.approx(pixels * rig.focal_mm / 36 * wide_m / distance, abs=0.06)


@pytest.mark.blender
def test_the_studio_is_built_around_a_large_fire(tmp_path):
    """Blender's own state: no wall in the domain, all cameras above the floor; the small one is as before."""
    scene_spec.save(POOL, tmp_path / "pool.json")
    scene_spec.save(PLAIN, tmp_path / "plain.json")
    found = in_blender(
        """
        from mathutils import Vector
        from gof_blender.pure import spec
        from gof_blender.scene import build
        for name in ("pool", "plain"):
            build.scene(spec.load(f"{sys.argv[1]}/{name}.json"))
            bpy.context.view_layer.update()
            turned = lambda thing, corner: list(thing.matrix_world @ Vector(corner))
            corners = lambda thing: [turned(thing, corner) for corner in thing.bound_box]
            result[name] = {thing.name: corners(thing) for thing in bpy.data.objects if thing.type == "MESH"}
            result[name + " cameras"] = [list(thing.matrix_world.translation) for thing in bpy.data.objects
                                         if thing.type == "CAMERA"]
            result[name + " light"] = [bpy.data.lights[0].energy, bpy.data.lights[0].size]
        """,
        tmp_path,
    )
    backdrop, floor = (np.array(found["pool"][name]) for name in ("Backdrop", "Floor"))
    assert backdrop[:, 1].min() > 4 and backdrop[:, 2].max() > 12
    for place in np.array(found["pool cameras"]):
        assert (floor[:, :2].min(0) < place[:2]).all() and (place[:2] < floor[:, :2].max(0)).all()
    assert np.array(found["plain"]["Backdrop"]).min(0) == pytest.approx([-4, 1.95, 0], abs=1e-6)
    assert found["plain light"] == pytest.approx([70.0, 1.5])
    large = found["pool light"][1] / 1.5
    assert found["pool light"][0] == pytest.approx(70 * large**2, rel=1e-6) and large > 4


def test_what_cannot_be_made_is_refused_before_a_folder_is_claimed(tmp_path, monkeypatch):
    monkeypatch.setattr(cost_model, "known_machine", lambda: cost_model.REFERENCE)
    monkeypatch.setattr(blender_process, "known_looks", lambda view: ["None", "High Contrast"])
    gone = replace(PLAIN, background="blend_file", blend_file=BlendFile("gone.blend"))
    cases = {
        "there is no file .*gone.blend": gone,
        "display.look must be one of None, High Contrast, got 'Nonsense'": replace(
            PLAIN, display=Display(look="Nonsense")
        ),
        "in the fire": replace(PLAIN, cameras=Rig(radius=0.1, height=0.5)),
        r"GB of memory.*lower render.percentage from 100 to \d+": replace(
            PLAIN, cameras=Rig(sensor_px=(65536, 65536)), render=Render(percentage=100)
        ),
        "years; lower": replace(
            PLAIN, clip=Clip(frames=9000), render=Render(percentage=5, samples=10**7), cameras=Rig(count=5)
        ),
    }
    for message, spec in cases.items():
        path = tmp_path / "spec.json"
        path.write_text(json.dumps(spec.to_dict()))
        for options in (["--estimate"], []):
            with pytest.raises(GofError, match=message):
                generate.main([str(path), "--out", str(tmp_path / "new"), *options])
        assert not (tmp_path / "new").exists()


def test_the_field_that_helps_is_named_with_its_largest_value(monkeypatch, tmp_path):
    monkeypatch.setattr(cost_model, "known_machine", lambda: cost_model.REFERENCE)
    monkeypatch.setattr(cost_model, "memory_mb", lambda: 4000.0)
    spec = replace(PLAIN, domain=Domain(size=(2, 2, 2), min=(-1, -1, 0), resolution=640))
    with pytest.raises(SpecError, match="lower domain.resolution from 640 to") as error:
        cost_model.require_room(spec, tmp_path)
    best = int(re.search(r"to (\d+)", str(error.value))[1])

    def memory(resolution):
        return cost_model.predict(cost_model.with_resolution(spec, resolution), cost_model.REFERENCE).memory_mb

    assert memory(best) <= 0.8 * 4000 < memory(best + 1)


def test_looks_are_those_of_the_installed_blender():
    pytest.importorskip("bpy", reason="its colour management is asked")
    found = in_blender(
        """
        view = bpy.context.scene.view_settings
        for name in ("Filmic", "AgX"):
            view.view_transform = name
            try:
                view.look = "Nonsense"
            except TypeError as error:
                result[name] = str(error).partition("not found in ")[2]
        """
    )
    import ast

    for view, known in found.items():
        assert blender_process.known_looks(view) == list(ast.literal_eval(known))


def test_what_cannot_be_read_or_made_is_said_in_words(tmp_path):
    (tmp_path / "empty.json").write_text(" \n")
    (tmp_path / "utf16.json").write_bytes(json.dumps(PLAIN.to_dict()).encode("utf-16"))
    for name, words in (
        ("empty", "the file is empty; copy or write it again"),
        ("utf16", "UTF-16 or UTF-32; save it as UTF-8"),
    ):
        with pytest.raises(SpecError, match=f"{name}.json: .*{words}"):
            scene_spec.load(tmp_path / f"{name}.json")
    for folder in (tmp_path / "empty.json", tmp_path / "empty.json" / "inside"):
        with pytest.raises(SpecError, match="choose a(nother|  *new) output folder"):
            Layout(folder).claim(PLAIN)


@pytest.mark.blender
def test_no_gas_of_the_emitter_is_seen_below_the_rim_of_the_workshops_bowl():
    fires = [
        Fire(shape="sphere", radius=0.15, position=(0, 0, 0.17)),
        Fire(shape="sphere", radius=0.2, position=(0.1, 0, 0.12)),  # reaches into the floor
    ]
    fields = {
        str(k): {key: getattr(fire, key) for key in ("shape", "radius", "position")} for k, fire in enumerate(fires)
    }
    found = in_blender(
        """
        import numpy as np
        from gof_blender.pure.fires import Fire
        from gof_blender.scene.backgrounds import workshop
        for name, fire in FIRES.items():
            burner, here = Fire(**fire).burner, bpy.context.scene.collection
            before = set(bpy.data.objects)
            workshop._fire_bowl(burner, here, None)
            bowl = next(thing for thing in set(bpy.data.objects) - before if thing.name.startswith("Fire Bowl"))
            x, y, top = burner.position
            hits = []
            for z in np.linspace(max(burner.bottom, 0), top, 12)[1:-1]:
                for turn in np.linspace(0, 2 * np.pi, 9)[:8]:
                    out = (np.cos(turn), np.sin(turn), 0)
                    start = np.array((x, y, z)) + burner.radius * np.array(out) - bowl.location
                    hits.append(bowl.ray_cast(start, out)[0])
            result[name] = hits
        """.replace("FIRES", repr(fields))
    )
    for name, hits in found.items():
        assert len(hits) == 80 and all(hits), fires[int(name)]
