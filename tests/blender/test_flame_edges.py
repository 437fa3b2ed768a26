"""A flame that reaches the domain's sides is cut off there, and said to be."""

import json

import pytest

from gof_blender.pure.layout import Layout, warnings_of_bake
from tests.blender.test_addon_fire import in_addon

pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")


@pytest.mark.blender
def test_a_flame_that_is_cut_off_is_said(tmp_path):
    """A column of light 2 cells wide whose share at the top is known: 0.3 of its widest section, in one frame only."""
    found = in_addon("""
        import numpy as np
        from types import SimpleNamespace
        from gof_blender.pure.spec import Clip, SceneSpec
        from gof_blender.scene import extra_truth
        spec = SceneSpec("x", clip=Clip(frames=9))
        def light(frame):
            values = np.zeros((8, 8, 12), np.float32)
            values[3:5, 3:5, :8] = 1.0
            if frame == spec.timeline.blender_frame(8):
                values[3:5, 3:5, 8:] = 0.3
            return values
        result["column"] = extra_truth.cut_off(spec, SimpleNamespace(light=light))
        result["dark"] = extra_truth.cut_off(spec, SimpleNamespace(light=lambda frame: np.zeros((4, 4, 4))))
    """)
    sides = ("-x side", "+x side", "-y side", "+y side")
    assert found["column"] == {"top": 0.3, **dict.fromkeys(sides, 0.0)}
    assert set(found["dark"].values()) == {0.0}
    layout = Layout(tmp_path)
    assert warnings_of_bake(layout) == []
    layout.hidden.mkdir()
    layout.bake_marker.write_text(json.dumps({"cut_off": found["column"]}))
    (note,) = warnings_of_bake(layout)
    assert "through its top (30 % of its widest section)" in note and "domain.size" in note
    layout.spec.write_text(json.dumps({"fire": {"grids": "elsewhere"}}))
    (note,) = warnings_of_bake(layout)
    assert "domain.size" not in note and "only its solver" in note
    layout.bake_marker.write_text("{}")
    assert warnings_of_bake(layout) == [], "of an older version"


@pytest.mark.blender
def test_gas_that_is_faster_than_gas_can_be_is_said(tmp_path):
    """A box of 1.2 m: sqrt(2 * 9.81 * 6 * 1.2) = 11.9 m/s, and 3 of a jet. A few wild cells are no runaway."""
    found = in_addon("""
        import numpy as np
        from types import SimpleNamespace
        from gof_blender.pure.effects import wind
        from gof_blender.pure.fires import Fire
        from gof_blender.pure.spec import Clip, SceneSpec
        from gof_blender.scene import extra_truth
        def speeds(speed, wild=0, effects=(), **fire):
            velocity = np.zeros((10, 10, 24, 3), np.float32)
            velocity[..., 2] = speed
            velocity.reshape(-1, 3)[:wild, 0] = 900.0
            source = SimpleNamespace(velocity=lambda step: velocity, index_to_world=np.diag([0.05, 0.05, 0.05, 1.0]))
            spec = SceneSpec("x", clip=Clip(frames=9), fire=Fire(**fire), effects=effects)
            return extra_truth.speeds(spec, source)
        result["calm"] = speeds(5.0, wild=2)
        result["wild"] = speeds(30.0)
        result["jet"] = speeds(5.0, shape="disc", jet_speed=3.0)
        result["wind"] = speeds(5.0, effects=(wind.Settings(2.0),))
        result["field"] = speeds(5.0, effects=(wind.Settings(2.0, unit="field"),))
        result["solver"] = speeds(90.0, speeds="solver")
    """)
    assert found["calm"] == {"fastest_m_s": 5.0, "most_m_s": 11.89}
    assert [found[name]["most_m_s"] for name in ("jet", "wind", "field", "solver")] == [14.89, 13.89, None, None]
    layout = Layout(tmp_path)
    layout.hidden.mkdir()
    layout.bake_marker.write_text(json.dumps(found["wild"]))
    (note,) = warnings_of_bake(layout)
    assert "gas reaches 30 m/s, and heat makes at most 12 m/s in this domain" in note and "vorticity" in note
    layout.spec.write_text(json.dumps({"fire": {"grids": "elsewhere"}}))
    assert "are the grids in m/s?" in warnings_of_bake(layout)[0]
    for name in ("calm", "solver", "field"):
        layout.bake_marker.write_text(json.dumps(found[name]))
        assert warnings_of_bake(layout) == []
