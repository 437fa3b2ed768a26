"""A flame that reaches the domain's sides is cut off there, and said to be."""

import json

import pytest

from gof_blender.pure.layout import Layout, leaving
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
    assert leaving(layout) == []
    layout.hidden.mkdir()
    layout.bake_marker.write_text(json.dumps({"cut_off": found["column"]}))
    (note,) = leaving(layout)
    assert "through its top (30 % of its widest section)" in note and "domain.size" in note
    layout.spec.write_text(json.dumps({"fire": {"grids": "elsewhere"}}))
    (note,) = leaving(layout)
    assert "domain.size" not in note and "only its solver" in note
    layout.bake_marker.write_text("{}")
    assert leaving(layout) == [], "of an older version"
