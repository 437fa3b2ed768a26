"""Gaussian splats of Blender's own: where GOF_BPY_5_3 names a Python that has Blender 5.3
(`python3.13 -m venv b53 && b53/bin/pip install bpy==5.3.0`); elsewhere, that none are offered."""

import os

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from tests.blender.runs import in_blender
from tests.blender.test_cloud_light import likeness
from tests.conftest import random_gaussians

pytestmark = pytest.mark.blender
PYTHON = os.environ.get("GOF_BPY_5_3", "")
newer = pytest.mark.skipif(not PYTHON, reason="no Blender 5.3 here: set GOF_BPY_5_3 to a Python that has its bpy")
SPLATS = """
import numpy as np
import gof_blender
from gof_blender.scene import compat, gaussian_nodes, point_cloud

gof_blender.register()
folder = sys.argv[1]
result["version"] = list(bpy.app.version)
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 100
if "older" in sys.argv:  # a cloud as a Blender without splats leaves it in a file
    modes, kept = gaussian_nodes.MODES, (compat.HAS_SPLATS, gaussian_nodes.LAYOUT, gaussian_nodes.INPUTS)
    compat.HAS_SPLATS, gaussian_nodes.LAYOUT = False, 5
    gaussian_nodes.INPUTS = (("Mode", gaussian_nodes.WHOLE, 0, 0, 3, ""), *gaussian_nodes.INPUTS[1:])
bpy.ops.gof.import_result(filepath=folder + "/result.npz", start_frame=0, fit="keep", mode="points")
if "older" in sys.argv:
    compat.HAS_SPLATS, gaussian_nodes.LAYOUT, gaussian_nodes.INPUTS = kept
thing = bpy.context.object
thing.location = (1, 2, 3)
settings = point_cloud.inputs(thing)
settings["Emission"] = 0.5
scene.gof.reconstruction.mode = "splats"
result["emission"] = point_cloud.inputs(thing)["Emission"]
light = np.zeros(3 * len(thing.data.vertices), np.float32)
thing.data.attributes["gs_light"].data.foreach_get("vector", light)
result["light"] = light.reshape(-1, 3).tolist()


def look(scene, frame):
    # what the modifier makes of the cloud at a frame
    scene.frame_set(frame)
    thing = next(other for other in scene.objects if other.type == "MESH")
    whole = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    splats = whole.pointcloud
    found = {"type": splats.type}
    for name, field, width in (
        ("position", "vector", 3), ("scale", "vector", 3), ("rotation", "value", 4), ("radiance:base", "color", 4),
        ("velocity", "vector", 3)
    ):
        data = splats.attributes[name].data
        values = np.zeros(len(data) * width, np.float32)
        data.foreach_get(field, values)
        found[name] = values.reshape(-1, width).tolist()
    return found


result["looks"] = {frame: look(scene, frame) for frame in (30, 65)}
bpy.ops.wm.save_as_mainfile(filepath=folder + "/flame.blend")
gof_blender.unregister()
bpy.ops.wm.open_mainfile(filepath=folder + "/flame.blend")
result["alone"] = look(bpy.context.scene, 65)
gof_blender.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
with bpy.data.libraries.load(folder + "/flame.blend", link=True) as (there, here):
    here.objects = ["result"]
bpy.context.scene.collection.objects.link(here.objects[0])
bpy.context.view_layer.update()
result["surfaces"] = bpy.context.scene.cycles.transparent_max_bounces
"""


@pytest.fixture(scope="module", params=["newer", "older"])
def found(request, tmp_path_factory) -> dict:
    folder = tmp_path_factory.mktemp("newer")
    random_gaussians(50).save(folder / "result.npz")
    result = in_blender(SPLATS, folder, request.param, python=PYTHON)
    assert result["version"] >= [5, 3, 0], f"{PYTHON} has an older Blender"
    return result | {"truth": TransientGaussians.load(folder / "result.npz")}


@newer
@pytest.mark.parametrize("frame", [30, 65, None])
def test_splats_of_blender_5_3_move(found, frame):
    """x0 + (t - t_mu) v and opacity exp(-0.5 ((t - t_mu) / t_sigma)^2) of what is not fainter than 1/255.

    Without a frame: of the saved file, opened without the add-on.
    """
    look, time_s = (found["looks"][str(frame)], frame / 100) if frame else (found["alone"], 0.65)
    g = found["truth"]
    age = np.where(g.dynamic, time_s - g.t_mu, 0.0)
    opacity = g.opacity * np.exp(-0.5 * (age / g.t_sigma) ** 2)
    seen = opacity >= 1 / 255
    assert look["type"] == "GAUSSIAN_SPLAT" and found["emission"] == 0.5
    assert 0 < seen.sum() < len(g)
    np.testing.assert_allclose(look["position"], (g.position + age[:, None] * g.velocity)[seen], atol=1e-5)
    np.testing.assert_allclose(look["velocity"], np.where(g.dynamic[:, None], g.velocity, 0)[seen], atol=1e-6)
    np.testing.assert_allclose(look["scale"], g.scale[seen], rtol=1e-5)
    turned = np.array(look["rotation"])  # q and -q are the same rotation
    turned *= np.sign((turned * g.rotation[seen]).sum(1, keepdims=True))
    np.testing.assert_allclose(turned, g.rotation[seen], atol=1e-6)
    radiance = np.array(look["radiance:base"])
    np.testing.assert_allclose(radiance[:, 3], opacity[seen], rtol=1e-4)
    shown = 0.5 + 0.28209479 * radiance[:, :3]
    linear = np.where(shown <= 0.04045, shown / 12.92, ((np.maximum(shown, 0) + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear, 0.5 * np.array(found["light"])[seen], rtol=1e-4, atol=1e-6)


@newer
def test_a_linked_flame_shines_in_blender_5_3(found):
    assert found["surfaces"] == 1024


@newer
@pytest.mark.parametrize(
    "emissive, transform, wall, least_db",
    # With colours of the file instead of the cloud's light: 21.2, 24.4 and 19.1.
    [(True, "Filmic", 0.3, 22.2), (True, "Standard", 0, 25.7), (False, "AgX", 0, 19.2)],
)
def test_splats_look_as_the_renderer_draws_them(tmp_path, emissive, transform, wall, least_db):
    assert likeness(tmp_path, emissive, transform, wall, "splats", samples=128, python=PYTHON) > least_db


def test_splats_are_offered_where_blender_has_them():
    found = in_blender("""
    import gof_blender
    from gof_blender.scene import compat
    gof_blender.register()
    modes = bpy.context.scene.gof.reconstruction.bl_rna.properties["mode"].enum_items
    result["modes"] = [item.identifier for item in modes]
    result["has"] = compat.HAS_SPLATS
    result["version"] = list(bpy.app.version)
    """)
    assert found["has"] == (found["version"] >= [5, 3, 0]) == ("splats" in found["modes"])


def test_a_function_of_blenders_own_is_found():
    """Blender's classes do not show their functions: `hasattr` says there is none, whatever the version."""
    result = in_blender(
        """
from gof_blender.scene.compat import has_function
result["there"] = [has_function("UILayout", "label"), has_function("UILayout", "progress")]
result["absent"] = [has_function("UILayout", "no_such"), has_function("NoSuchType", "resize")]
result["resize"] = [has_function("PointCloud", "resize"), hasattr(bpy.data.pointclouds.new("probe"), "resize")]
"""
    )
    assert result["there"] == [True, True] and result["absent"] == [False, False]
    assert result["resize"][0] == result["resize"][1]
