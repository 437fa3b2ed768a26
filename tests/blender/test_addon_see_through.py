"""A cloud shines in Cycles wherever it is brought: the picture is that of the scene that it was imported into."""

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from tests.blender.runs import in_blender

START = """
import numpy as np
import gof_blender
from pathlib import Path

folder = Path(sys.argv[1])
blend = str(folder / "flame.blend")
gof_blender.register()

def empty():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene

def mean_light(scene):
    '''Of a picture across a row of faint balls, as Cycles gives it: linear.'''
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        scene.collection.objects.link(scene.camera)
        scene.camera.location, scene.camera.rotation_euler = (0, -3, 0), (np.pi / 2, 0, 0)
        scene.camera.data.lens = 400
    render = scene.render
    render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    render.resolution_x = render.resolution_y = 8
    render.image_settings.file_format = "OPEN_EXR"
    render.filepath = str(folder / "seen.exr")
    bpy.ops.render.render(write_still=True, scene=scene.name)
    seen = bpy.data.images.load(render.filepath)
    return float(np.array(seen.pixels[:]).reshape(-1, 4)[:, :3].mean())

def of_file(kind, link, name):
    with bpy.data.libraries.load(blend, link=link) as (there, here):
        setattr(here, kind, [name])
    return getattr(here, kind)[0]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Sixty faint balls in a row along the view, so that only a ray through all of them sees their light."""
    folder = tmp_path_factory.mktemp("row")
    n = 60
    TransientGaussians(
        position=np.column_stack([np.zeros(n), np.linspace(-0.5, 0.5, n), np.zeros(n)]),
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.full((n, 3), 0.1),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.05),
        color=np.tile([0.9, 0.5, 0.2], (n, 1)),
        dynamic=np.ones(n, bool),
    ).save(folder / "result.npz")
    return folder


@pytest.fixture(scope="module")
def home(folder) -> float:
    """Light in the scene of the import; it is saved as flame.blend."""
    found = in_blender(
        START
        + """
scene = empty()
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"), mode="ellipsoids")
thing = bpy.context.object
group = bpy.data.collections.new("Campfire")
group.objects.link(thing)
scene.collection.children.link(group)
scene.collection.objects.unlink(thing)
result["light"] = mean_light(scene)
scene.cycles.transparent_max_bounces = 8
gof_blender.unregister()
result["stopped"] = mean_light(scene)
bpy.ops.wm.save_as_mainfile(filepath=blend)
""",
        folder,
    )
    assert found["stopped"] < 0.7 * found["light"], "a picture that stops early is another one"
    return found["light"]


@pytest.mark.blender
@pytest.mark.parametrize("link", [False, True])
@pytest.mark.parametrize("how", ["object", "instance", "other scene", "nodes"])
def test_it_shines_where_it_is_brought(folder, home, how, link):
    found = in_blender(
        START
        + """
link, how = sys.argv[2] == "True", sys.argv[3]
scene = empty()
if how == "instance":  # as File > Link does of a collection
    holder = bpy.data.objects.new("instance", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", of_file("collections", link, "Campfire")
    scene.collection.objects.link(holder)
elif how == "nodes":
    tree = bpy.data.node_groups.new("shows another", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    there, out = tree.nodes.new("GeometryNodeObjectInfo"), tree.nodes.new("NodeGroupOutput")
    there.inputs["Object"].default_value = of_file("objects", link, "result")
    tree.links.new(there.outputs["Geometry"], out.inputs[0])
    holder = bpy.data.objects.new("stand-in", bpy.data.meshes.new("stand-in"))
    holder.modifiers.new("shows another", "NODES").node_group = tree
    scene.collection.objects.link(holder)
else:
    if how == "other scene":
        scene = bpy.data.scenes.new("Other")
    scene.collection.objects.link(of_file("objects", link, "result"))
result["light"] = mean_light(scene)
result["others"] = [other.cycles.transparent_max_bounces for other in bpy.data.scenes if other != scene]
""",
        folder,
        link,
        how,
    )
    assert found["light"] == pytest.approx(home, rel=0.02)
    assert set(found["others"]) <= {8}, "a scene without a flame stays as it is"


@pytest.mark.blender
def test_an_old_file_is_mended_as_it_opens(folder, home):
    """Also one whose scene has another engine as yet, and as soon as something is done in it."""
    found = in_blender(
        START
        + """
bpy.ops.wm.open_mainfile(filepath=blend)
scene = bpy.context.scene
result["opened"] = scene.cycles.transparent_max_bounces
scene.cycles.transparent_max_bounces = 8
bpy.context.view_layer.update()
result["light"] = mean_light(scene)
""",
        folder,
    )
    assert found["opened"] == 1024 and found["light"] == pytest.approx(home, rel=0.02)
