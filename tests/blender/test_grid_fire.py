"""A fire of grids, as any solver could hand it over: a Gaussian puff of light that flies with a known velocity.

All expected values are closed forms: the line integral of a Gaussian, the pinhole projection of its centre, and fields
that are linear in space and time, which linear interpolation keeps exactly.
"""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.core.fields import VelocitySequence
from gof.core.fire import FireDescription, Hearth
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.emission import FlameGrid
from gof.evaluate.eve import score_eve
from gof_benchmark.commands import generate
from gof_benchmark.generator.blender_process import run_stage
from gof_benchmark.scenes import claim, load_scene
from gof_benchmark.solvers.grids import FireFrame, FireGrids, write_fire
from gof_blender.core.checked_json import SpecError
from gof_blender.pure import effects
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.cost_model import REFERENCE, cells, predict
from gof_blender.pure.effects import motion_blur, wind
from gof_blender.pure.layout import Layout
from gof_blender.pure.rig import Rig
from gof_blender.pure.spec import Domain, GridFire, Render, SceneSpec
from gof_blender.pure.timing import Clip
from tests.blender.runs import channels

CELL_M, GRID, STEP_S = 0.0125, (40, 36, 48), 0.02  # the stored clock is 0, 0.02, ... 0.08 s
SIGMA_M, START_M, VELOCITY = 0.06, np.array([-0.08, -0.04, 0.15]), np.array([1.5, 0.8, 3.0])
LIGHT = np.array([30.0, 12.0, 2.0])  # of the puff's middle, per metre
SHEAR, CHANGE = np.array([[0.0, 2.0, 0.0], [0.0, 0.0, -1.0], [0.5, 0.0, 0.3]]), np.array([0.1, -0.2, 0.4])


def centre(time_s: float) -> np.ndarray:
    return START_M + VELOCITY * time_s


def write_puff(path, sheared=False, frames=5) -> FireGrids:
    """The puff's grids. The gas moves with VELOCITY, or with a field that is linear in place and time."""
    index_to_world = np.diag([CELL_M, CELL_M, CELL_M, 1.0])
    index_to_world[:3, 3] = [-CELL_M * GRID[0] / 2, -CELL_M * GRID[1] / 2, 0.0]
    index = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in GRID), indexing="ij"), -1)
    places = index * CELL_M + index_to_world[:3, 3]

    def frame(k: int) -> FireFrame:
        shape = np.exp(-((places - centre(k * STEP_S)) ** 2).sum(-1) / (2 * SIGMA_M**2))
        moving = gas(places, k * STEP_S) if sheared else np.broadcast_to(VELOCITY, places.shape)
        return FireFrame(velocity=moving, emission=shape[..., None] * LIGHT)

    times = tuple(STEP_S * k for k in range(frames))
    about = FireDescription("puff", "closed form 1.0", times, "a Gaussian", hearths=(Hearth(1.0, 0.1, (0, 0, 0), 0.1),))
    return write_fire(path, about, index_to_world, frame)


def gas(places: np.ndarray, time_s: float) -> np.ndarray:
    return VELOCITY + places @ SHEAR.T + CHANGE * time_s / STEP_S


def spec_of(grids, **changes) -> SceneSpec:
    settings = {
        "clip": Clip(frames=4, fps=100.0, warm_up_frames=3),
        "fire": GridFire(str(grids), start_s=STEP_S, radiance=0.5),
        "cameras": Rig(count=2, radius=1.2, height=0.5, look_at=(0.0, 0.0, 0.3), sensor_px=(64, 64), roll_deg=0),
        "render": Render(100, samples=24, plate_samples=1, volume_step_rate=0.5, denoise=False),
        "background": "studio",
        "ground_truth": ("grids",),
    }
    return SceneSpec("puff", **settings | changes)


@pytest.fixture(scope="module")
def puff(tmp_path_factory) -> Layout:
    """A finished dataset of the puff, its folder of grids named relative to the spec; tests must not change it."""
    folder = tmp_path_factory.mktemp("puff")
    write_puff(folder / "grids")
    data = spec_of("grids").to_dict()
    (folder / "puff.json").write_text(json.dumps(data))
    assert generate.main([str(folder / "puff.json"), "--out", str(folder / "data")]) == 0
    return Layout(folder / "data")


def flame(layout: Layout, camera: str, frame: int) -> np.ndarray:
    found = channels(layout.frame(camera, frame).exr)
    return np.stack([found[f"flame.{c}"] for c in "RGB"], -1).astype(float)


def line_integrals(camera, time_s: float) -> np.ndarray:
    """(H, W): of a puff of unit light along the ray of every pixel."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.K).T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    middle = camera.world_to_camera[:3, :3] @ centre(time_s) + camera.world_to_camera[:3, 3]
    distance2 = middle @ middle - (rays @ middle) ** 2
    return np.sqrt(2 * np.pi) * SIGMA_M * np.exp(-distance2 / (2 * SIGMA_M**2))


def centroid(picture: np.ndarray) -> np.ndarray:
    light = picture.sum(-1)
    rows, columns = np.indices(light.shape) + 0.5
    return np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()


@pytest.mark.blender
@pytest.mark.parametrize("camera", [0, 1])
def test_pictures_are_the_line_integrals_of_the_emission(puff, camera):
    """At stored times, and between them the mean of the neighbours, which at this speed is another picture."""
    view = Dataset.open(puff.root).cameras[camera]
    stored = [line_integrals(view, STEP_S * k) for k in (1, 2, 3)]
    expected = [stored[0], (stored[0] + stored[1]) / 2, stored[1], (stored[1] + stored[2]) / 2]
    between = line_integrals(view, 1.5 * STEP_S)
    assert np.abs(expected[1] - between).max() > 0.1 * between.max(), "the comparison would show nothing"
    for frame, image in enumerate(expected):
        found = flame(puff, view.name, frame) / (0.5 * LIGHT)
        peak = image.max()
        for channel in range(3):
            assert np.abs(found[..., channel] - image).max() < 0.05 * peak, f"frame {frame}"
            assert found[..., channel].sum() == pytest.approx(image.sum(), rel=0.02)


@pytest.mark.blender
def test_the_picture_moves_as_the_projected_velocity_says(puff):
    for view in Dataset.open(puff.root).cameras:
        seen = [centroid(flame(puff, view.name, frame)) for frame in (0, 2)]
        pixels, _ = view.project(np.array([centre(STEP_S), centre(2 * STEP_S)]))
        assert np.linalg.norm(pixels[1] - pixels[0]) > 3
        np.testing.assert_allclose(seen, pixels, atol=0.15)


@pytest.mark.blender
def test_the_dataset_is_a_dataset_like_any_other(puff):
    dataset = Dataset.open(puff.root)
    fire = dataset.description.provenance["fire"]
    assert (fire["name"], fire["solver"], fire["seed"]) == ("puff", "closed form 1.0", 0)
    assert SceneSpec.from_dict(dataset.description.spec).domain is None
    mask = dataset.mask(0, 2) > 0
    np.testing.assert_array_equal(mask, flame(puff, "cam_0", 2).max(-1) > 0.02)
    assert 0.01 < mask.mean() < 0.5
    np.testing.assert_allclose(dataset.velocity.at(0.02).velocity, np.broadcast_to(VELOCITY, (*GRID, 3)), rtol=1e-6)


@pytest.mark.blender
def test_gaussians_with_the_true_velocity_have_no_error(puff):
    """Where light is drawn from the flame grid, as it is where the Gaussians sit."""
    dataset = Dataset.open(puff.root)
    one = TransientGaussians(
        position=centre(STEP_S)[None],
        velocity=VELOCITY[None],
        t_mu=np.array([0.0]),
        t_sigma=np.array([np.inf]),
        scale=np.full((1, 3), 2 * SIGMA_M),  # wide enough to answer for all of the light
        rotation=np.array([[1.0, 0, 0, 0]]),
        opacity=np.array([0.9]),
        color=np.ones((1, 3)),
        dynamic=np.array([True]),
    )
    grid = FlameGrid(puff.grid("flame"))
    assert grid.light_exponent == 1.0
    for frame in (0, 2):  # the puff is where its closed form says, drawn from light and not from a power of it
        drawn = grid.places(frame / 100, 4000, np.random.default_rng(0))
        np.testing.assert_allclose(drawn.mean(0), centre(STEP_S + frame / 100), atol=0.004)
        assert drawn.std(0) == pytest.approx(SIGMA_M, rel=0.05)
    found = score_eve(one, dataset.velocity, grid, dataset.times_s[[0, 2]])
    assert found.pooled.l2 < 1e-5 and found.pooled.cos_sim > 0.9999 and found.empty == 0
    wrong = score_eve(replace(one, velocity=-one.velocity), dataset.velocity, grid, dataset.times_s[[0]])
    assert wrong.pooled.l2 > 1.9


@pytest.mark.blender
def test_velocity_is_the_truth_where_the_fire_stands_and_on_its_clock(tmp_path):
    """Moved, in slow motion, between stored frames; without a picture."""
    write_puff(tmp_path / "grids", sheared=True)
    position, slow = np.array([0.4, -0.3, 0.25]), 0.5
    fire = GridFire(str(tmp_path / "grids"), start_s=0.012, position=tuple(position.tolist()))
    spec = spec_of(tmp_path / "grids", fire=fire, clip=Clip(frames=5, fps=50.0, warm_up_frames=0, time_scale=slow))
    layout = Layout(tmp_path / "data")
    claim(layout, spec)
    for stage in ("bake", "ground-truth"):
        run_stage(stage, layout.root)
    truth = VelocitySequence.open(layout.velocity)
    np.testing.assert_allclose(truth.times_s, np.arange(5) / 50, atol=1e-12)
    low, high = position - [0.2, 0.18, -0.05], position + [0.2, 0.18, 0.5]
    points = np.random.default_rng(1).uniform(low, high, (200, 3))
    for time_s in truth.times_s:
        expected = slow * gas(points - position, 0.012 + slow * time_s)
        np.testing.assert_allclose(truth.at(time_s).sample(points), expected, atol=2e-5)
    assert not truth.at(0.0).contains(np.array([[0.0, 0.0, 0.1]]))[0], "nothing is left where the box was"
    flame_grid = FlameGrid(layout.grid("flame"))
    drawn = flame_grid.places(0.04, 4000, np.random.default_rng(0))  # 0.032 s: 0.4 of frame 1, 0.6 of frame 2
    np.testing.assert_allclose(drawn.mean(0), position + centre(0.032), atol=0.004)


def test_round_trip_and_paths(tmp_path):
    (tmp_path / "fires").mkdir()
    spec = spec_of("fires/puff", effects=(motion_blur.Settings(),))
    assert SceneSpec.from_dict(spec.to_dict()) == spec and spec.domain is None
    scene_spec.save(spec.resolved(tmp_path), tmp_path / "spec.json")
    assert json.loads((tmp_path / "spec.json").read_text())["fire"] == {
        "grids": "fires/puff",
        "start_s": STEP_S,
        "position": [0.0, 0.0, 0.0],
        "radiance": 0.5,
    }
    assert scene_spec.load(tmp_path / "spec.json").fire.grids == (tmp_path / "fires/puff").as_posix()
    assert scene_spec.load(tmp_path / "spec.json").with_preset("preview").domain is None


@pytest.mark.parametrize(
    "change, message",
    [
        ({"domain": Domain()}, "domain must be left out"),
        ({"effects": (wind.Settings(),)}, r"effects must be those of cameras.*\['wind'\]"),
        ({"fire": {"grids": "g", "fuel": "wood"}}, "fire.fuel is not a field"),
        ({"fire": {"grids": 3}}, "fire.grids must be a text"),
        ({"fire": {"grids": "g", "radiance": 0}}, "fire.radiance must be positive"),
        ({"fire": {"grids": "g", "position": [0, 0]}}, "fire.position must be 3 numbers"),
    ],
)
def test_wrong_specs_are_refused_by_name(change, message):
    with pytest.raises(SpecError, match=message):
        if isinstance(change.get("fire"), dict):
            SceneSpec.from_dict(spec_of("g").to_dict() | change)
        else:
            spec_of("g", **change)


@pytest.mark.parametrize("name", effects.names())
def test_effects_of_the_bake_and_no_others_are_refused(name):
    ours = {"vorticity", "wind", "floor", "smoke", "obstacles", "moving_emitter", "fine_noise"}
    settings = (effects.module(name).Settings(),)
    if name in ours:
        with pytest.raises(SpecError, match=name):
            spec_of("g", effects=settings)
    else:
        assert spec_of("g", effects=settings).effect_names == [name]


def other_clock(grids):
    change(grids / "velocity.zarr/zarr.json", lambda d: d["attributes"].update(time_s=[0, 1, 2, 3, 4]))


def other_box(grids):
    change(grids / "emission.zarr/zarr.json", lambda d: d["attributes"]["index_to_world"][0].__setitem__(3, 9.0))


def slabs(grids):
    for name in ("velocity", "emission"):
        file = grids / f"{name}.zarr/zarr.json"
        change(file, lambda d: d["attributes"]["index_to_world"][2].__setitem__(2, 0.5))


def change(file, how):
    data = json.loads(file.read_text())
    how(data)
    file.write_text(json.dumps(data))


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda g: (g / "fire.json").unlink(), r"fire\.grids.*fire\.json: no such file"),
        (lambda g: shutil.rmtree(g / "emission.zarr"), r"emission\.zarr.*zarr\.json: no such file"),
        (lambda g: shutil.move(g / "velocity.zarr", g / "v"), r"velocity\.zarr.*zarr\.json: no such file"),
        (lambda g: change(g / "emission.zarr/zarr.json", lambda d: d["attributes"].update(quantity="soot")), "soot"),
        (lambda g: change(g / "velocity.zarr/zarr.json", lambda d: d["attributes"].update(units="knots")), "knots"),
        (
            lambda g: change(g / "emission.zarr/zarr.json", lambda d: d["codecs"][1].update(name="blosc")),
            r"blosc.*GzipCodec",
        ),
        (other_clock, r"velocity\.zarr: its clock is not that of fire\.json"),
        (other_box, r"emission\.zarr: its box is not that of velocity"),
        (slabs, "upright cubes"),
    ],
)
def test_wrong_grids_are_refused_before_anything_is_made(tmp_path, spoil, message):
    write_puff(tmp_path / "grids")
    scene_spec.save(spec_of(tmp_path / "grids"), tmp_path / "puff.json")
    assert load_scene(str(tmp_path / "puff.json")).name == "puff"
    spoil(tmp_path / "grids")
    with pytest.raises(GofError, match=message):
        generate.main([str(tmp_path / "puff.json"), "--out", str(tmp_path / "data")])
    assert not (tmp_path / "data").exists()


def test_a_clip_beyond_the_stored_clock_is_refused(tmp_path):
    write_puff(tmp_path / "grids")
    fits = replace(spec_of(tmp_path / "grids"), clip=Clip(frames=7, fps=100.0))  # 0.02 to 0.08 s, the last frame's
    assert fits.box.resolution == 48
    for wrong in (
        replace(fits, clip=Clip(frames=8, fps=100.0)),
        replace(fits, fire=replace(fits.fire, start_s=-0.01)),
        replace(fits, effects=(motion_blur.Settings(),)),  # the last shutter closes after the end
    ):
        with pytest.raises(SpecError, match=r"fire\.start_s must be such that the clip.*0\.\.0\.08 s"):
            _ = wrong.box


def test_cost_is_that_of_a_conversion(tmp_path):
    write_puff(tmp_path / "grids")
    spec = spec_of(tmp_path / "grids")
    assert cells(spec) == np.prod(GRID)
    simulated = SceneSpec("same", clip=spec.clip, domain=Domain((-0.25, -0.225, 0), (0.5, 0.45, 0.6), 48))
    assert cells(simulated) == cells(spec)
    assert predict(spec, REFERENCE).bake_s < predict(simulated, REFERENCE).bake_s


def test_a_damaged_frame_is_named(tmp_path):
    from gof_blender.core.errors import DataFormatError
    from gof_blender.pure.fires import FireStore

    write_puff(tmp_path / "grids")
    chunk = next(path for path in (tmp_path / "grids/emission.zarr/c/2").rglob("*") if path.is_file())
    chunk.write_bytes(chunk.read_bytes()[:50])
    store = FireStore(tmp_path / "grids")
    store.emission.cells_at(STEP_S)
    with pytest.raises(DataFormatError, match=r"emission\.zarr: frame 2: c/2.*truncated"):
        store.emission.cells_at(1.5 * STEP_S)
