"""A reconstruction as OpenVDB grids: against closed forms, and as Blender reads the files."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof_blender.pure import voxels
from gof_blender.pure.io.cloud import GaussianCloud
from tests.blender.runs import in_blender
from tests.conftest import random_gaussians

ROOT = Path(__file__).resolve().parents[2]
BLENDER = shutil.which("blender")


def cloud(**changes) -> GaussianCloud:
    one = {
        "position": [[0.1, -0.2, 0.9]],
        "velocity": [[1.0, 0.5, 2.0]],
        "t_mu": [0.2],
        "t_sigma": [0.05],
        "scale": [[0.08, 0.08, 0.08]],
        "rotation": [[1.0, 0.0, 0.0, 0.0]],
        "opacity": [0.6],
        "color": [[1.0, 0.5, 0.0]],
        "dynamic": [True],
    } | changes
    return GaussianCloud(**{k: np.array(v, bool if k == "dynamic" else np.float32) for k, v in one.items()})


def test_a_ray_through_the_centre_adds_the_opacity_times_the_colour():
    """The integral along a ray is alpha(t) c; 0.5 of sRGB is 0.2140 of linear light."""
    one, time_s = cloud(), 0.24
    alpha = 0.6 * np.exp(-0.5 * (0.04 / 0.05) ** 2)
    centre = np.array([0.1, -0.2, 0.9]) + 0.04 * np.array([1.0, 0.5, 2.0])
    voxel = 0.01
    low = centre - 0.4 - voxel / 2  # a voxel's centre lies on the Gaussian's
    grids = voxels.grids_at(one, time_s, low, (81, 81, 81), voxel)
    ray = grids["emission"][:, 40, 40].sum(axis=0) * voxel
    assert ray == pytest.approx(alpha * np.array([1.0, 0.21404, 0.0]), rel=4e-3)  # 3 sigma hold 99.7 %
    assert grids["density"][40, 40].sum() * voxel == pytest.approx(alpha, rel=4e-3)
    lit = grids["density"] > 0
    assert np.abs(grids["velocity"][lit] - [1.0, 0.5, 2.0]).max() < 1e-6 and not grids["velocity"][~lit].any()


def test_the_whole_light_of_a_turned_ellipsoid_and_of_one_thinner_than_a_voxel():
    """The integral over space is alpha (2 pi)^1.5 sx sy sz / (sqrt(2 pi) s), whatever the turn and the voxel."""
    for scale in ([0.12, 0.05, 0.03], [0.06, 0.06, 0.002]):
        one = cloud(scale=[scale], rotation=[[0.8, 0.2, -0.4, 0.4]], t_sigma=[np.inf], velocity=[[0, 0, 0]])
        low, shape = voxels.box_of(one, np.array([0.0]), 0.02)
        found = voxels.grids_at(one, 0.0, low, shape, 0.02)["density"].astype(float).sum() * 0.02**3
        volume = np.prod(scale)
        wanted = 0.6 * (2 * np.pi) ** 1.5 * volume / (np.sqrt(2 * np.pi) * np.cbrt(volume))
        assert found == pytest.approx(0.9707 * wanted, rel=0.01)  # a ball of 3 sigma holds 97.07 %


def test_places_and_opacities_are_those_of_the_library(tmp_path):
    result = random_gaussians(200)
    path = result.save(tmp_path / "r.npz")
    from gof_blender.pure.io import cloud as clouds

    place, opacity = voxels.state_at(clouds.load(path), 0.37)
    theirs = TransientGaussians.load(path).at(0.37)
    np.testing.assert_allclose(place, theirs[0], atol=1e-5)
    np.testing.assert_allclose(opacity, theirs[1], atol=1e-6)


def test_velocity_is_weighted_and_impossible_boxes_are_refused():
    """Two Gaussians at one place: the mean by their opacities."""
    two = {k: np.repeat(v, 2, axis=0) for k, v in vars(cloud(t_sigma=[np.inf])).items() if v is not None}
    two["velocity"], two["opacity"] = np.array([[1, 0, 0], [0, 0, 4]], np.float32), np.array([0.2, 0.6], np.float32)
    two["t_mu"] = np.zeros(2, np.float32)
    both = GaussianCloud(**two)
    low, shape = voxels.box_of(both, np.array([0.0]), 0.02)
    found = voxels.grids_at(both, 0.0, low, shape, 0.02)
    assert np.abs(found["velocity"][found["density"] > 0] - [0.25, 0, 3.0]).max() < 1e-5
    with pytest.raises(voxels.VoxelError, match="make them .* m or more"):
        voxels.box_of(both, np.array([0.0]), 1e-5)
    with pytest.raises(voxels.VoxelError, match="nothing is visible"):
        voxels.box_of(cloud(), np.array([50.0]), 0.02)


@pytest.mark.blender
def test_files_are_where_blender_has_the_cloud(tmp_path):
    """Written by the operator, read by Blender's own openvdb and by its volume object."""
    pytest.importorskip("bpy", reason="the operator needs Blender")
    one = cloud()
    TransientGaussians(
        **{k: v for k, v in vars(one).items() if v is not None and k not in ("begin", "end", "velocity_sd", "datum")}
    ).save(tmp_path / "one.npz")
    found = in_blender(
        """
        import gof_blender, numpy as np
        from gof_blender.scene import images  # puts Blender's own Python packages on the path
        import openvdb
        gof_blender.register()
        scene = bpy.context.scene
        scene.render.fps, scene.frame_start, scene.frame_end = 100, 21, 25
        bpy.ops.gof.import_result(filepath=sys.argv[1] + "/one.npz", fit="keep")
        result["poll"] = bpy.ops.gof.export_vdb.poll()
        result["said"] = list(bpy.ops.gof.export_vdb(filepath=sys.argv[1] + "/flame.vdb", voxel_m=0.02))
        path = sys.argv[1] + "/flame_0025.vdb"
        grids, _ = openvdb.readAll(path)
        for grid in grids:
            low, high = grid.evalActiveVoxelBoundingBox()
            values = np.zeros((*(np.array(high) - low + 1), 3)[: 3 + (grid.name != "density")], np.float32)
            grid.copyToArray(values, ijk=low)
            weight = values if grid.name == "density" else values.sum(-1)
            at = np.indices(weight.shape).reshape(3, -1) + np.array(low)[:, None]
            centre = (at * weight.ravel()).sum(1) / weight.sum()
            result[grid.name] = [list(grid.transform.indexToWorld(centre.tolist())), float(values.max())]
        volume = bpy.data.volumes.new("flame")
        volume.filepath = path
        thing = bpy.data.objects.new("flame", volume)
        scene.collection.objects.link(thing)
        bpy.context.view_layer.update()
        volume.grids.load()
        result["grids"] = sorted(grid.name for grid in volume.grids)
        corners = np.array([thing.matrix_world @ __import__("mathutils").Vector(c) for c in thing.bound_box])
        result["middle"] = ((corners.min(0) + corners.max(0)) / 2).tolist()
        """,
        tmp_path,
    )
    assert found["poll"] and found["said"] == ["FINISHED"]
    assert sorted(path.name for path in tmp_path.glob("*.vdb")) == [f"flame_{k:04d}.vdb" for k in range(21, 26)]
    centre = np.array([0.1, -0.2, 0.9]) + 0.04 * np.array([1.0, 0.5, 2.0])  # frame 25 is 0.24 s
    assert found["density"][0] == pytest.approx(centre, abs=1e-3)
    assert found["velocity"][1] == pytest.approx(2.0, abs=1e-5)
    assert found["grids"] == ["density", "emission", "velocity"]
    assert np.abs(found["middle"] - centre).max() < 0.08, "Blender's box is of whole leaves of 8 voxels"


@pytest.mark.blender
def test_a_cloud_that_was_moved_is_written_where_it_stands(tmp_path):
    """Turned, twice as large and 10 m away: as Blender's own matrix has it. What Opacity Cut hides is not written."""
    pytest.importorskip("bpy", reason="the operator needs Blender")
    found = in_blender(
        """
        import gof_blender, numpy as np
        from gof_blender.scene import images, point_cloud  # the former puts Blender's Python packages on the path
        from gof_blender.pure.io.cloud import GaussianCloud
        import openvdb
        gof_blender.register()
        scene = bpy.context.scene
        scene.frame_start = scene.frame_end = 1
        n = 40
        faint = np.arange(n) >= 20
        place = np.random.default_rng(1).normal(0, 0.05, (n, 3)).astype(np.float32)
        place[faint, 0] += 1
        one = lambda value: np.full(n, value, np.float32)
        rows = lambda *row: np.tile(np.array(row, np.float32), (n, 1))
        cloud = GaussianCloud(
            position=place, velocity=rows(0, 0, 1), t_mu=one(0), t_sigma=one(1), scale=rows(0.03, 0.03, 0.03),
            rotation=rows(1, 0, 0, 0), opacity=np.where(faint, 0.05, 0.9).astype(np.float32),
            color=rows(0.5, 0.5, 0.5), dynamic=np.ones(n, bool),
        )
        thing = point_cloud.add_point_cloud(cloud, 1.0, "points")
        thing.location, thing.scale, thing.rotation_euler = (10, 0, 0), (2, 2, 2), (0, np.pi / 2, 0)
        point_cloud.inputs(thing)["Opacity Cut"] = 0.1
        bpy.context.view_layer.update()
        thing.select_set(True)
        bpy.context.view_layer.objects.active = thing
        result["said"] = list(bpy.ops.gof.export_vdb(filepath=sys.argv[1] + "/f.vdb", voxel_m=0.02))
        result["wanted"] = list(thing.matrix_world @ __import__("mathutils").Vector(place[~faint].mean(0).tolist()))
        grids = {grid.name: grid for grid in openvdb.readAll(sys.argv[1] + "/f_0001.vdb")[0]}
        density, velocity = grids["density"], grids["velocity"]
        low, high = density.evalActiveVoxelBoundingBox()
        values = np.zeros(np.array(high) - low + 1, np.float32)
        density.copyToArray(values, ijk=low)
        at = np.indices(values.shape).reshape(3, -1) + np.array(low)[:, None]
        middle = (at * values.ravel()).sum(1) / values.sum()
        result["middle"] = list(density.transform.indexToWorld(middle.tolist()))
        result["ends"] = [list(density.transform.indexToWorld([float(v) for v in end])) for end in (low, high)]
        result["velocity"] = list(next(velocity.iterOnValues()).value)
        """,
        tmp_path,
    )
    assert found["said"] == ["FINISHED"]
    assert found["middle"] == pytest.approx(found["wanted"], abs=0.03)
    assert np.ptp(found["ends"], axis=0).max() < 1.0, "the faint ones stand 2 m away"
    assert found["velocity"] == pytest.approx([2, 0, 0], abs=1e-3)


@pytest.mark.skipif(not BLENDER, reason="no Blender application on this machine (Debian: apt-get install blender)")
def test_what_debians_blender_writes_is_what_the_wheel_writes(tmp_path):
    """With Debian's python3-openvdb; without it, and of USD and Alembic, one line says what to do."""
    random_gaussians(40).save(tmp_path / "some.npz")
    (tmp_path / "gof_blender").symlink_to(ROOT / "blender_addon")  # the name that the installed package has
    script = """
        import sys, json
        sys.path.insert(0, FOLDER)
        import bpy, gof_blender
        gof_blender.register()
        scene = bpy.context.scene
        scene.render.fps, scene.frame_start, scene.frame_end = 100, 11, 12
        bpy.ops.gof.import_result(filepath=FOLDER + "/some.npz", fit="keep")
        said = {}
        for name, operator, more in (("vdb", bpy.ops.gof.export_vdb, {"voxel_m": 0.05}),
                                     ("usdc", bpy.ops.gof.export_points, {}), ("abc", bpy.ops.gof.export_points, {})):
            try:
                operator(filepath=f"{FOLDER}/NAME.{name}", **more)
                said[name] = ""
            except RuntimeError as error:
                said[name] = str(error)
        json.dump(said, open(FOLDER + "/NAME.json", "w"))
    """
    script = "\n".join(line[8:] for line in script.splitlines()).replace("FOLDER", repr(str(tmp_path)))
    (tmp_path / "application.py").write_text(script.replace("NAME", "application"))
    command = [BLENDER, "-b", "--factory-startup", "--python-exit-code", "1", "--python"]
    plain = {name: value for name, value in os.environ.items() if name != "OCIO"}  # the wheel's, once it is imported
    run = subprocess.run(
        [*command, tmp_path / "application.py"], capture_output=True, text=True, timeout=120, env=plain
    )
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    said = json.loads((tmp_path / "application.json").read_text())
    if not (tmp_path / "application_0011.vdb").exists():
        assert (
            "without the OpenVDB module for Python: use Blender 4.4 or later (Debian: python3-openvdb)" in said["vdb"]
        )
        pytest.skip("no python3-openvdb for the Blender application")
    for name, wanted in (("usdc", "pxr modules for Python: use 4.2"), ("abc", "built without Alembic")):
        assert (tmp_path / f"application.{name}").exists() or wanted in said[name]
    pytest.importorskip("bpy", reason="the second Blender")
    found = in_blender(
        script.replace("NAME", "wheel")
        + """
import numpy as np
import openvdb
for frame in ("0011", "0012"):
    theirs, ours = ({g.name: g for g in openvdb.readAll(f"{sys.argv[1]}/{name}_{frame}.vdb")[0]} for name in
                    ("application", "wheel"))
    for name, grid in ours.items():
        low, high = grid.evalActiveVoxelBoundingBox()
        values = np.zeros((2, *(np.array(high) - low + 1), 3)[: 4 + (name != "density")], np.float32)
        grid.copyToArray(values[0], ijk=low)
        theirs[name].copyToArray(values[1], ijk=low)
        place = [g.transform.indexToWorld((1, 2, 3)) for g in (grid, theirs[name])]
        result[f"{name} {frame}"] = [float(np.abs(values[0] - values[1]).max() / values[0].max()), place]
        """,
        tmp_path,
    )
    assert len(found) == 6
    for off, (here, there) in found.values():
        assert off < 1e-5 and here == pytest.approx(there, abs=1e-9)
