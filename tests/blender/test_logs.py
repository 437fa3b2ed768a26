"""How many logs burn: a field of the spec, which leaves specs without it as they were."""

import numpy as np
import pytest

from gof_blender.core.checked_json import SpecError
from gof_blender.pure.fires import Fire
from gof_blender.pure.spec import SceneSpec
from tests.blender.runs import in_blender
from tests.blender.test_addon_fire import in_addon


def test_three_logs_are_not_written_and_others_are():
    three = SceneSpec("x", fire=Fire(shape="logs", position=(0, 0, 0.15)))
    five = SceneSpec("x", fire=Fire(shape="logs", position=(0, 0, 0.15), logs=5))
    assert "logs" not in three.to_dict()["fire"] and five.to_dict()["fire"]["logs"] == 5
    assert SceneSpec.from_dict(three.to_dict()) == three and SceneSpec.from_dict(five.to_dict()) == five
    assert three.differences(five) == ["fire"]


@pytest.mark.parametrize(
    ("shape", "logs", "rule"),
    [("logs", 1, r"in \[2, 8\], got 1"), ("logs", 9, r"in \[2, 8\], got 9"), ("disc", 5, "left out unless fire.shape")],
)
def test_numbers_out_of_range_are_refused_by_name(shape, logs, rule):
    with pytest.raises(SpecError, match=f"fire.logs must be {rule}"):
        Fire(shape=shape, logs=logs)


@pytest.mark.blender
def test_logs_lie_apart_inside_the_burners_circle_and_three_are_as_before():
    found = in_blender(
        """
        import numpy as np
        from gof_blender.scene import meshes
        for count in range(2, 9):
            thing = meshes.crossed_logs("Logs", 0.3, bpy.context.scene.collection, count)
            places = np.empty((len(thing.data.vertices), 3), np.float32)
            thing.data.vertices.foreach_get("co", places.ravel())
            result[str(count)] = places.astype(float).tolist()
        """
    )
    for count in range(2, 9):
        logs = np.array(found[str(count)]).reshape(count, 2, 14, 3)  # both ends of each: rings of 14 corners
        middles = logs.mean(axis=2)
        assert np.hypot(*logs[..., :2].reshape(-1, 2).T).max() < 0.3 * 1.04, (
            "as far as three of them have always reached"
        )
        ends = middles[:, 1, :2]
        gaps = [np.linalg.norm(a - b) for i, a in enumerate(ends) for b in ends[:i]]
        assert min(gaps) > 2 * 0.3 / 4.5, "no outer end lies in another log"
        assert (middles[:, 0, 2] > middles[:, 1, 2]).all(), "they lean on each other"
    three = np.array(found["3"])[[0, 30, 83]]  # as the version without the field had them
    before = [
        (-0.1200117, 0.03265948, 0.06),
        (0.03769107, -0.09157666, 0.1098821),
        (-0.004096983, -0.2888947, -0.08768249),
    ]
    np.testing.assert_allclose(three, before, atol=1e-7)


def test_the_panel_has_them():
    found = in_addon(
        """
        fire.shape, fire.logs = "logs", 5
        result["spec"] = scene_spec.of_settings(scene).to_dict()["fire"]["logs"]
        bpy.ops.gof.add_fire()
        result["corners"] = len(place.find(scene, "emitter").data.vertices)
        fire.logs = 99
        result["most"] = fire.logs
        fire.shape = "disc"
        result["disc"] = scene_spec.of_settings(scene).to_dict()["fire"].get("logs")
        """
    )
    assert found == {"spec": 5, "corners": 5 * 28, "most": 8, "disc": None}
