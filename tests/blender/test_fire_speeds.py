"""Lift that follows the fire's size: hot gas is accelerated alike at every size, as by gravity, in real bakes."""

import pytest

from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import wind
from gof_blender.pure.spec import Domain, Fire, SceneSpec
from gof_blender.pure.timing import Clip
from tests.blender.runs import in_blender

pytest.importorskip("bpy", reason="bakes need the bpy wheel")
pytestmark = pytest.mark.blender


def sized(longest: float, **fire) -> SceneSpec:
    """A ball of fuel in a cube, and the same in another size, seen just after its start."""
    half = longest / 2
    return SceneSpec(
        "sized",
        clip=Clip(3, 400.0 / longest**0.5, 0),
        domain=Domain((-half, -half, 0), (longest,) * 3, 20),
        fire=Fire("propane_high", "sphere", (0, 0, half), 0.2 * longest, **fire),
    )


def gas(spec: SceneSpec, folder, axis: int, still: bool = False) -> list[float]:
    """Velocity (m/s) along an axis after each step: upwards the largest, sideways that in the middle of the ball."""
    scene_spec.save(spec, folder / "spec.json")
    return in_blender(
        """
        from pathlib import Path
        from gof_blender.pure import spec as scene_spec
        from gof_blender.scene import build, fire
        from gof_blender.scene.mantaflow_source import MantaflowSource
        folder, axis, still = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "True"
        spec = scene_spec.load(folder / "spec.json")
        objects = build.scene(spec)
        fire.keep_for_dataset(objects.domain_settings)
        objects.emitter.modifiers["Fluid"].flow_settings.use_texture = False
        if still:
            objects.domain_settings.beta = 0.0
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
        fire.bake(objects.domain, spec.timeline.steps_needed)
        source = MantaflowSource(spec)
        fields = [source.velocity(step)[..., axis] for step in (1, 2, 3)]
        result["speed"] = [float(field.max() if axis == 2 else field[10, 10, 10]) for field in fields]
    """,
        folder,
        axis,
        still,
    )["speed"]


@pytest.mark.parametrize("speeds, power", [("physical", 0.0), ("solver", -1.0)])
def test_acceleration_is_that_of_gravity_at_every_size(tmp_path, speeds, power):
    found = {}
    for longest in (0.1, 10.0):
        folder = tmp_path / f"{longest}"
        folder.mkdir()
        spec = sized(longest, speeds=speeds)
        found[longest] = gas(spec, folder, 2)[1] / (2 * spec.timeline.solver_step_s)
    assert found[0.1] > 0 and found[10.0] / found[0.1] == pytest.approx(100.0**power, rel=0.05)
    if speeds == "physical":
        assert 1.0 * 9.81 < found[10.0] < 7 * 9.81, "gas of 600 to 2300 K: gravity times its excess over 293 K"


def test_wind_pushes_burning_gas_as_it_says(tmp_path):
    from dataclasses import replace

    spec = replace(sized(1.6), effects=(wind.Settings(3.0, gusts=0.0),))
    first, second, _ = gas(spec, tmp_path, 0, still=True)
    height = 2.5 * 2 * spec.fire.radius
    through_s = 2 * height / (6.8 * height**0.5)  # time that gas takes through the flame
    assert (second - first) / spec.timeline.solver_step_s == pytest.approx(3.0 / through_s, rel=0.1)
