"""A folder of grids of another solver in the Benchmark panel: the puff of light of `test_grid_fire`."""

import numpy as np
import pytest

from gof.dataset import Dataset
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from tests.blender.test_addon_benchmark import PAPER
from tests.blender.test_addon_fire import in_addon
from tests.blender.test_grid_fire import CELL_M, GRID, START_M, STEP_S, VELOCITY, write_puff

pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")
pytestmark = pytest.mark.blender
LIFT_M = 0.2


@pytest.fixture(scope="module")
def burnt(tmp_path_factory):
    """What the panel said before, and the datasets of the puff in this scene and in the studio."""
    folder = tmp_path_factory.mktemp("puff")
    write_puff(folder / "puff")
    found = in_addon(
        PAPER
        + """
        settings, folder = scene.gof.benchmark, sys.argv[1]
        settings.preset, settings.grids, settings.start_s, settings.radiance = "toy", folder + "/puff", 0.02, 0.5
        fire.clearance, fire.cameras.radius, fire.cameras.height, fire.cameras.look_at_height = 0.2, 1.2, 0.5, 0.4
        fire.effects.wind.use = fire.effects.exposure.use = True
        bpy.data.objects.remove(bpy.data.objects["Cube"])  # it stands around the fire and would hide it
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        for background in ("scene", "studio"):
            settings.background, settings.folder = background, f"{folder}/{background}"
            result[background] = [plan(), list(bpy.ops.gof.bake_render())]
        """,
        folder,
    )
    return folder, found


def test_it_burns_instead_of_the_panels_fire(burnt):
    folder, found = burnt
    for background in ("scene", "studio"):
        plan, pressed = found[background]
        assert "Grids are not simulated: vorticity, wind of the Fire panel left out" in " ".join(plan.split())
        assert "About" in plan and "[Bake & Render]" in plan and pressed == ["FINISHED"]
        layout, dataset = Layout(folder / background), Dataset.open(folder / background)
        spec = scene_spec.load(layout.spec)
        assert spec.domain is None and spec.effect_names == ["exposure"] and spec.fire.position == (0, 0, LIFT_M)
        matrix = dataset.velocity.index_to_world
        corner = (-CELL_M * GRID[0] / 2, -CELL_M * GRID[1] / 2, LIFT_M)
        np.testing.assert_allclose(matrix[:3, 3], corner, atol=1e-6)
        for time_s in dataset.times_s:
            field = dataset.velocity.at(time_s).velocity
            np.testing.assert_allclose(field, np.broadcast_to(VELOCITY, field.shape), rtol=1e-6)


@pytest.mark.parametrize("background", ["scene", "studio"])
def test_the_pictures_show_it_where_it_is(burnt, background):
    """The middle of the mask is the puff's centre, projected, in every picture."""
    dataset = Dataset.open(burnt[0] / background)
    for number, camera in enumerate(dataset.cameras):
        for frame, time_s in enumerate(dataset.times_s):
            place = START_M + VELOCITY * (STEP_S + time_s) + (0, 0, LIFT_M)
            seen = camera.world_to_camera[:3, :3] @ place + camera.world_to_camera[:3, 3]
            expected = (camera.K @ seen)[:2] / seen[2]
            rows, columns = np.nonzero(dataset.mask(number, frame) > 0.5)
            middle = (columns.min() + columns.max() + 1) / 2, (rows.min() + rows.max() + 1) / 2
            assert np.abs(np.array(middle) - expected).max() < 1.0


def test_what_is_no_fire_is_refused_by_file_and_field(tmp_path):
    write_puff(tmp_path / "short", frames=2)
    (tmp_path / "vdb").mkdir()
    (tmp_path / "vdb" / "cache_0001.vdb").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    found = in_addon(
        PAPER
        + """
        settings, folder = scene.gof.benchmark, sys.argv[1]
        settings.preset, settings.background, settings.folder = "toy", "studio", folder + "/new"
        for name in ("absent", "empty", "vdb", "short"):
            settings.grids = f"{folder}/{name}"
            result[name] = [plan(), message(bpy.ops.gof.bake_render)]
        """,
        tmp_path,
    )
    for name, texts in found.items():
        for text in (" ".join(part.split()) for part in texts):
            assert ("Start must" if name == "short" else "Grids: ") in text, name
            assert "[Bake" not in text
    assert "fire.json: no such file" in found["empty"][1] and "write_fire" in found["absent"][1]
    assert f"python -m gof_benchmark.solvers.vdb {tmp_path}/vdb/*.vdb --out {tmp_path}/vdb_fire" in found["vdb"][1]
    assert "0..0.02 s" in found["short"][1]
    assert not (tmp_path / "new").exists()
