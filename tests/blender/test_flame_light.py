"""Light of soot: Planck's and Kirchhoff's laws; pictures of a real bake against line integrals and whole renders."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.ndimage import map_coordinates

from gof.dataset import Dataset
from gof_benchmark.commands import generate
from gof_blender.pure import fire_scaling, soot
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.brightness import Brightness
from gof_blender.pure.fuels import FUELS
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import Domain, Fire
from tests.blender.runs import TOY, channels, in_blender

PLANCK, LIGHT, BOLTZMANN = 6.62607015e-34, 299792458.0, 1.380649e-23


def planck(wavelength_m: float, kelvin: float) -> float:
    return 1 / wavelength_m**5 / math.expm1(PLANCK * LIGHT / (wavelength_m * BOLTZMANN * kelvin))


@pytest.mark.parametrize("kelvin", [1200.0, 1600.0, 2000.0])
def test_black_bodies_follow_plancks_law(kelvin):
    shown = [planck(1e-6 * um, kelvin) / planck(1e-6 * um, soot.WHITE_K) for um in soot.WAVELENGTHS_UM]
    reference = planck(1e-6 * soot.WAVELENGTHS_UM[0], soot.REFERENCE_K) / planck(0.6e-6, soot.WHITE_K)
    expected = soot.REFERENCE_RADIANCE * np.array(shown) / reference
    np.testing.assert_allclose(soot.black_body(np.array(kelvin)), expected, rtol=0.05)  # white is not quite Wien's


def test_soot_absorbs_red_light_more_than_heat_by_plancks_mean():
    """Of 1 / wavelength over Planck's radiation, summed over wavelengths at 1500 K."""
    wavelength = np.geomspace(2e-7, 2e-3, 20001)
    radiance = 1 / wavelength**5 / np.expm1(PLANCK * LIGHT / (wavelength * BOLTZMANN * 1500))
    mean = trapezoid(radiance / wavelength, wavelength) / trapezoid(radiance, wavelength)
    assert 1 / 0.6e-6 / mean == pytest.approx(soot.VISIBLE_OVER_TOTAL, rel=0.01)


@pytest.mark.parametrize("thin", [False, True])
@pytest.mark.parametrize("fuel", [name for name, fuel in FUELS.items() if fuel.sooty])
def test_what_absorbs_shines_as_a_black_body_and_no_brighter(fuel, thin):
    sheet, exposure = soot.sheet(FUELS[fuel], 0.3, thin=thin), soot.SHEET_EXPOSURE if thin else 1
    red = sheet.emission[1:, 0] / sheet.absorption[1:].clip(1e-9)
    lit = sheet.absorption[1:] > 0
    assert red[lit].max() <= exposure * soot.black_body(np.array(FUELS[fuel].soot_k))[0] * (1 + 1e-9)
    assert sheet.absorption[0] == 0 and not sheet.emission[0].any() and not sheet.blue[0].any(), "air is dark"


def test_thin_sheets_are_where_the_reaction_passes_their_value_and_nowhere_else():
    """On a steady slope from fuel to air there is one sheet."""
    sheet = soot.sheet(FUELS["propane_high"], 0.26, thin=True)
    light = sheet.light(np.linspace(0, 1, 1001)[:, None], np.array([1.0]))[:, 0]
    shines = np.linspace(0, 1, 1001)[light > 0.01 * light.max()]
    assert 0.2 < shines.min() < soot.SHEET_AT < shines.max() < 0.46 and np.ptp(shines) < 0.25


@pytest.mark.parametrize("shape", [(5, 6, 7), (3, 1, 2)])
def test_places_within_cells_are_those_of_the_spline_that_cycles_draws(shape):
    """Against scipy's cubic B-spline without its filter; the mean over a cell of a constant is that constant."""
    grid = np.random.default_rng(0).random(shape)
    places = soot.within_cells(grid)
    found = {tuple(p.ravel()) for p in places.round(9)}
    for side in np.ndindex(2, 2, 2):
        at = (
            np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"))
            + (np.array(side) / 2 - 0.25)[:, None, None, None]
        )
        expected = map_coordinates(np.pad(grid, 3, "edge"), at + 3, order=3, prefilter=False)
        assert tuple(expected.ravel().round(9)) in found
    np.testing.assert_allclose(soot.within_cells(np.full(shape, 0.3)), 0.3)


@pytest.mark.parametrize("thin", [False, True])
def test_a_flame_is_never_brighter_by_its_size_than_a_black_body(thin):
    """Through its middle: of 1 cm, of a campfire, of 4 m; without the factor each metre would add the same."""
    seen = []
    for fuel, diameter in (("propane_low", 0.01), ("wood", 0.5), ("gasoline", 4.0)):
        sheet = soot.sheet(FUELS[fuel], diameter, thin=thin)
        most = int(np.argmax(sheet.emission[:, 0]))
        thickness = sheet.absorption[most] * diameter
        seen.append(sheet.emission[most, 0] / sheet.absorption[most] * -math.expm1(-thickness))
    assert max(seen) < 8 * min(seen) and min(seen) > 1.0


def test_constants_follow_froude_and_are_one_at_the_reference():
    fuel = FUELS["propane_high"]
    same = fire_scaling.scaled(fuel, fire_scaling.REFERENCE_D_M, fire_scaling.REFERENCE_L_M)
    assert same.gravity == pytest.approx(fire_scaling.LIFT)
    assert (same.burning_rate, same.amount) == pytest.approx((fuel.burning_rate, fuel.amount))
    tiny = fire_scaling.scaled(fuel, 1e-4, 1e-3)
    assert tiny.burning_rate == fire_scaling.MOST_RATE
    whole = tiny.amount / tiny.burning_rate * (0.26 / 1e-4) ** 0.4
    assert whole == pytest.approx(fuel.amount / fuel.burning_rate), (
        "burning time follows also where Blender's rate ends"
    )
    assert tiny.confinement < 0.1, "what is laminar gets no eddies"


def test_shares_of_clipped_and_black_pixels():
    picture = np.zeros((2, 4, 3), np.uint8)
    picture[0] = (255, 255, 90), (255, 200, 90), (20, 10, 0), (255, 252, 0)
    mask = np.array([[True] * 4, [False] * 4])
    assert Brightness.of(picture, mask) == Brightness(0.5, 0.5, 0.25)
    assert "lower fire.intensity" in str(Brightness.of(picture, mask))
    assert "shows no flame" in str(Brightness.of(picture, ~mask & False))


@pytest.fixture(scope="module")
def sooty_run(tmp_path_factory) -> Layout:
    """A toy fire, brighter per paths than noise: opaque enough that what is behind it matters."""
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    folder = tmp_path_factory.mktemp("soot")
    spec = replace(
        TOY,
        clip=replace(TOY.clip, frames=2, warm_up_frames=16),
        domain=Domain(resolution=24),
        fire=Fire("gasoline", radius=0.2),
        cameras=replace(TOY.cameras, count=1),
        render=replace(TOY.render, samples=32, plate_samples=64),
        ground_truth=("grids",),
    )
    scene_spec.save(spec, folder / "spec.json")
    generate.main([str(folder / "spec.json"), "--out", str(folder / "data")])
    return Layout(folder / "data")


@pytest.mark.blender
def test_pictures_are_the_line_integrals_of_what_glows_and_absorbs(sooty_run):
    """Against our own integration over the stored grids, by cubic splines as in Cycles."""
    found = in_blender(
        """
        import numpy as np
        from pathlib import Path
        from gof_blender.pure import soot
        from gof_blender.pure import spec as scene_spec
        from scipy.ndimage import map_coordinates
        from gof_blender.pure.layout import Layout
        from gof_blender.scene import render, rig
        from gof_blender.scene.mantaflow_source import MantaflowSource
        mantaflow.enable()
        layout = Layout(Path(sys.argv[1]))
        spec = scene_spec.load(layout.spec)
        bpy.ops.wm.open_mainfile(filepath=str(layout.blend))
        source = MantaflowSource(spec)
        bpy.context.scene.frame_set(spec.timeline.blender_frame(1))
        reaction = dict(source._read_scalars())["flame"]
        matrix = source.index_to_world
        renderer = render.FrameRenderer(spec, layout)
        _, flame, cover = renderer._light(1, 0)
        K = rig.intrinsics(renderer._cameras[0], bpy.context.scene)
        pose = np.linalg.inv(rig.world_to_camera(renderer._cameras[0]))
        h, w = cover.shape[:2]
        y, x = np.mgrid[:h, :w] + 0.5
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T
        length = np.linalg.norm(rays, axis=-1)
        step = 0.005
        depth, seen, glow = np.zeros((h, w)), np.zeros((h, w)), 0.0
        sheet, stops = spec.fire.sheet, np.linspace(0, 1, soot.STOPS)
        inverse = np.linalg.inv(matrix)
        for t in np.arange(1.8, 3.9, step):
            world = (rays / length[..., None] * t) @ pose[:3, :3].T + pose[:3, 3]
            index = world @ inverse[:3, :3].T + inverse[:3, 3] - 0.5
            inside = ((index > 0) & (index < np.array(reaction.shape) - 1)).all(-1)
            cubic = map_coordinates(reaction, np.moveaxis(index, -1, 0), order=3, prefilter=False)
            value = np.where(inside, cubic, 0.0)
            sooty = soot.soot_share(world[..., 2] - spec.fire.burner.bottom, sheet.onset_m)
            k = np.interp(value, stops, sheet.absorption) * sooty
            e = np.interp(value, stops, sheet.emission[:, 0]) * sooty
            e += np.interp(value, stops, sheet.blue[:, 0]) * (1 - sooty)
            glow = glow + np.exp(-depth - k * step / 2) * e * step
            depth = depth + k * step
        ours, theirs = 1 - np.exp(-depth), cover[..., 0]
        def compared(ours, theirs):
            return [float(ours.sum()), float(theirs.sum()), float(np.corrcoef(ours.ravel(), theirs.ravel())[0, 1])]
        result["cover"], result["light"] = compared(ours, theirs), compared(glow, flame[..., 0])
        result["most"] = float(theirs.max())
    """,
        sooty_run.root,
    )
    for name in ("cover", "light"):
        ours, theirs, alike = found[name]
        assert theirs == pytest.approx(ours, rel=0.05) and alike > 0.97, name
    assert found["most"] > 0.5


@pytest.mark.blender
def test_plate_seen_through_the_flame_plus_fire_is_the_whole_render(sooty_run):
    found = in_blender(
        """
        import numpy as np
        from pathlib import Path
        from gof_blender.pure import spec as scene_spec
        from gof_blender.pure.layout import Layout
        from gof_blender.scene import images, render, rig
        mantaflow.enable()
        layout = Layout(Path(sys.argv[1]))
        spec = scene_spec.load(layout.spec)
        bpy.ops.wm.open_mainfile(filepath=str(layout.blend))
        render.configure(spec)
        bpy.context.scene.cycles.samples = 256
        bpy.context.scene.frame_set(spec.timeline.blender_frame(1))
        whole = render._beauty(render._render(rig.find(spec)[0], layout.hidden / "whole.exr"))[..., :3]
        ours = images.read_exr(layout.frame("cam_0", 1).exr)
        ours = np.stack([ours[c] for c in "RGB"], -1)
        mask = images.read_png(layout.frame("cam_0", 1).mask)[..., 0] > 0
        for name, where in (("flame", mask), ("around", ~mask)):
            result[name] = [ours[where].mean(0).tolist(), whole[where].mean(0).tolist()]
    """,
        sooty_run.root,
    )
    np.testing.assert_allclose(found["flame"][0], found["flame"][1], rtol=0.04)
    np.testing.assert_allclose(found["around"][0], found["around"][1], rtol=0.06)


@pytest.mark.blender
def test_the_fire_lights_the_room_in_its_own_colour(sooty_run):
    """On the studio's grey floor and backdrop: colour of what the fire adds, over their own, is that of the flame."""
    plate, frame = channels(sooty_run.static_exr("cam_0")), channels(sooty_run.frame("cam_0", 1).exr)
    flame, mask = np.stack([frame[f"flame.{c}"] for c in "RGB"], -1), Dataset.open(sooty_run.root).mask(0, 1) > 0
    for _ in range(3):  # well away from the flame
        mask = mask | np.roll(mask, 1, 0) | np.roll(mask, -1, 0) | np.roll(mask, 1, 1) | np.roll(mask, -1, 1)
    added = np.array([(frame[c] - plate[c])[~mask].sum() for c in "RGB"])
    own = flame.sum((0, 1))
    assert added[0] > 0.02 * plate["R"][~mask].sum()
    np.testing.assert_allclose(added / added[0], own / own[0], rtol=0.25)  # the floor's greys differ by 10 %


@pytest.mark.blender
def test_truth_of_the_light_is_the_light(sooty_run):
    zarr = pytest.importorskip("zarr")
    flame = zarr.open_array(str(sooty_run.grid("flame")), mode="r")
    assert flame.attrs["light_exponent"] == 1.0 and flame.attrs["units"] == "linear scene radiance per metre"
    assert flame[1].max() > 1.0
    assert Brightness.read(sooty_run.brightness).flame > 0.01
    assert "brightness" in sooty_run.costs.read_text()
