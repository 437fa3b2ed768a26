"""A flame of faint and bright, small and large Gaussians looks in Cycles as the renderer draws it."""

from pathlib import Path

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.render import render
from tests.blender.runs import in_blender

pytestmark = pytest.mark.blender
WIDTH, HEIGHT, FOCAL = 48, 80, 250.0  # pixels
SEEN = """
import numpy as np
import gof_blender
from gof_blender.scene import display
from pathlib import Path

folder, transform, wall = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
gof_blender.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.view_settings.view_transform = transform
render = scene.render
render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", int(sys.argv[8]), False
scene.cycles.pixel_filter_type = "BOX"
render.resolution_x, render.resolution_y = int(sys.argv[4]), int(sys.argv[5])
scene.world = bpy.data.worlds.new("wall")
scene.world.use_nodes = True
light = display.ToneCurve.measure(scene).light(np.array([wall]))[0]
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (light,) * 3 + (1,)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera, camera.location, camera.rotation_euler = camera, (0, -3, 0.3), (np.pi / 2, 0, 0)
camera.data.sensor_fit, camera.data.sensor_height = "VERTICAL", 24
camera.data.lens = 24 * float(sys.argv[6]) / render.resolution_y
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"), mode=sys.argv[7])
scene.frame_set(1)
settings = render.image_settings
settings.file_format, settings.color_mode = "PNG", "RGB"
render.filepath = str(folder / "seen.png")
bpy.ops.render.render(write_still=True)
result["passed"] = scene.cycles.min_transparent_bounces
image = bpy.data.images.load(render.filepath)
image.colorspace_settings.name = "Non-Color"
result["picture"] = np.array(image.pixels[:]).reshape(render.resolution_y, render.resolution_x, 4)[::-1, :, :3].tolist()
"""


def flame(emissive: bool) -> TransientGaussians:
    """Sizes over two octaves each way, opacities over more than one decade."""
    rng, n = np.random.default_rng(5), 500
    height = rng.uniform(0.05, 0.55, n)
    width = 0.09 * (1 - height)
    hue = rng.uniform(0, 1, n)
    return TransientGaussians(
        position=np.column_stack([width * rng.standard_normal(n), width * rng.standard_normal(n), height]),
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=0.014 * 2 ** np.clip(rng.standard_normal((n, 1)), -2, 2) * rng.uniform(0.6, 1.6, (n, 3)),
        rotation=rng.standard_normal((n, 4)),
        opacity=10 ** rng.uniform(-1.8, -0.3, n),
        color=np.column_stack([0.8 + 0.2 * hue, 0.3 + 0.5 * hue, 0.1 * hue]),
        dynamic=np.zeros(n, bool),
        emissive=emissive,
    )


@pytest.mark.parametrize(
    "emissive, transform, wall, least_db",
    # At 4 samples. Where each sample ends in one Gaussian or passes it, by chance: 18.3, 16.9 and 17.0. Emission by a
    # point for each Gaussian instead of its extent: 16.9, 20.3 and 11.1. A grey wall is partly hidden; AgX shows
    # saturated colours paler.
    [(True, "Filmic", 0.3, 21.5), (True, "Standard", 0, 25.5), (False, "AgX", 0, 19.5)],
)
def test_a_flame_looks_as_its_renderer_draws_it(tmp_path, emissive, transform, wall, least_db):
    assert likeness(tmp_path, emissive, transform, wall) > least_db


def likeness(folder: Path, emissive: bool, transform: str, wall: float, mode="ellipsoids", samples=4, **where) -> float:
    """Return dB of the flame in Cycles against the renderer's picture of it."""
    g = flame(emissive)
    g.save(folder / "result.npz")
    found = in_blender(SEEN, folder, transform, wall, WIDTH, HEIGHT, FOCAL, mode, samples, **where)
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
    front = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0.3], [0, 1, 0, 3], [0, 0, 0, 1]])
    camera = Camera("front", WIDTH, HEIGHT, K, front)
    wanted = np.clip(render(g, camera, 0.0, background=np.full((HEIGHT, WIDTH, 3), wall, np.float32))["color"], 0, 1)
    assert (found["passed"] >= 256) == emissive, "surfaces of a flame that every ray passes"
    lit = np.abs(wanted - wall).max(-1) > 0.04
    assert 0.1 < lit.mean() < 0.7
    error = np.array(found["picture"])[lit] - wanted[lit]
    return -10 * np.log10((error**2).mean())


def test_light_is_finite_at_its_bad_points():
    found = in_blender("""
    import numpy as np
    from gof_blender.pure.io.cloud import GaussianCloud
    from gof_blender.scene import display, lamps

    def cloud(n, **changes):
        given = dict(position=np.zeros((n, 3)), velocity=np.zeros((n, 3)), t_mu=np.linspace(0, 1, n))
        given |= dict(t_sigma=np.full(n, 0.1), scale=np.full((n, 3), 0.02), rotation=np.tile([1.0, 0, 0, 0], (n, 1)))
        given |= dict(opacity=np.full(n, 0.3), color=np.full((n, 3), 0.8), dynamic=np.ones(n, bool))
        given |= changes
        return GaussianCloud(**{k: v.astype(np.float32) if v.dtype == float else v for k, v in given.items()})

    n = 4
    cases = {
        "one": cloud(1),
        "clear": cloud(n, opacity=np.zeros(n)),
        "black": cloud(n, color=np.zeros((n, 3))),
        "white and opaque": cloud(n, color=np.ones((n, 3)), opacity=np.ones(n)),
        "always": cloud(n, t_sigma=np.full(n, np.inf)),
        "never lives": cloud(n, t_sigma=np.full(n, 1e-12)),
        "far away": cloud(n, position=np.array([[0, 0, 0], [1e6, 0, 0], [0, 1e6, 0], [0, 0, -1e6]], float)),
        "huge beside tiny": cloud(n, scale=np.repeat([[1e-5], [1e-3], [1.0], [1e3]], 3, 1)),
        "from the start": cloud(n, begin=np.full(n, -np.inf), end=np.full(n, 0.5)),
        "to the end": cloud(n, begin=np.array([0.0, 0.1, 0.2, 0.3]), end=np.array([0.2, 0.3, np.inf, np.inf])),
    }
    curve = display.ToneCurve.measure(bpy.context.scene)
    for name, it in cases.items():
        light = display.emission(it, curve)
        fine = bool(np.isfinite(light).all() and (light >= 0).all())
        for place, radius, times, intensity in lamps.groups(it, light):
            fine &= all(bool(np.isfinite(x).all()) for x in (place, radius, times, intensity))
            fine &= bool((intensity >= 0).all()) and radius >= 0
        result[name] = [fine, float(light.max()), list(light.shape)]
    """)
    assert len(found) == 10
    for name, (fine, most, shape) in found.items():
        assert fine and shape[1] == 3, name
        assert (most > 0) == (name != "black"), name
