"""The benchmark's fires: dev and test are separate by construction, and made with one command."""

import contextlib
import json
import shutil
import subprocess
from dataclasses import replace

import pytest

from gof.core.errors import DataFormatError, MissingDependencyError
from gof.dataset import Dataset
from gof_benchmark.fires import FOLDER, SPLITS, __main__, fires, making, require_seal
from gof_benchmark.fires.twins import Traits, differences, nearest, traits, traits_by_name
from gof_blender.pure import spec as scene_spec
from tests.blender.runs import TOY
from tests.solvers.conftest import write_small_fire

EVERYTHING = [fire for split in SPLITS for fire in fires(split)]
POOL = Traits("Mantaflow", "gasoline", "disc", 0.10, 0.0, 0.4, 1.0, 2.0, 100.0)


def test_both_splits_have_fires_of_both_solvers():
    for split in SPLITS:
        assert {fire.foam is None for fire in EVERYTHING if fire.split == split} == {True, False}
    assert len({fire.name for fire in EVERYTHING}) == len(EVERYTHING)
    assert len({fire.spec.seed for fire in EVERYTHING}) == len(EVERYTHING), "no two fires draw the same numbers"


@pytest.mark.parametrize("fire", [fire for fire in EVERYTHING if fire.foam], ids=lambda fire: fire.name)
def test_a_clip_ends_before_its_grids_do(fire):
    seen = fire.spec.fire.start_s + fire.spec.timeline.simulated_s(fire.spec.timeline.steps_needed[-1])
    assert seen <= (fire.foam.frames - 1) / fire.foam.frame_rate_hz + 1e-9


# ---------------------------------------------------------------- sealed


def test_the_test_specs_are_those_that_were_sealed():
    subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=FOLDER / "test", check=True)
    require_seal(FOLDER / "test")


@pytest.mark.parametrize("change", ["a number", "a new fire", "one less"])
def test_a_change_of_a_test_spec_is_refused_by_name(tmp_path, change):
    folder = tmp_path / "test"
    shutil.copytree(FOLDER / "test", folder)
    require_seal(folder)
    path = folder / "jet.json"
    if change == "a number":
        path.write_text(path.read_text().replace("3.2", "3.3"))
    elif change == "a new fire":
        shutil.copy(path, folder / "jet_2.json")
    else:
        path.unlink()
    with pytest.raises(DataFormatError, match=r"jet(_2)?\.json is not as sealed"):
        fires("test", tmp_path)


# ---------------------------------------------------------------- no twins


def test_no_test_fire_is_a_near_twin_of_what_a_method_is_developed_on():
    tests = traits_by_name([fire for fire in EVERYTHING if fire.split == "test"])
    others = __main__.seen_before(EVERYTHING)
    assert len(others) >= 20 and "scenes/demo" in others
    assert not [(a, b) for a, one in tests.items() for b, other in others.items() if not differences(one, other)]


@pytest.mark.parametrize(
    "changes, twins",
    [
        ({}, True),
        ({"radius": 0.1249, "wind": 0.5, "eddies": 0.8, "fps": 120.0}, True),
        ({"radius": 0.14}, False),
        ({"wind": 0.0}, False),
        ({"jet": 0.5}, False),
        ({"flame_eddies": 1.4}, False),
        ({"fps": 50.0}, False),
        ({"fuel": "wood"}, False),
        ({"shape": "sphere"}, False),
        ({"solver": "OpenFOAM"}, False),
    ],
)
def test_what_makes_two_fires_near_twins(changes, twins):
    other = replace(POOL, **changes)
    assert (differences(POOL, other) == ()) == twins == (differences(other, POOL) == ())
    if len(changes) == 1 and not twins:
        assert differences(POOL, other)[0].startswith(next(iter(changes)).replace("_", " "))


def test_the_nearest_fire_differs_in_fewest_traits_then_least():
    others = {
        "two traits": replace(POOL, fuel="wood", fps=25.0),
        "far": replace(POOL, radius=0.2),
        "near": replace(POOL, radius=0.14),
    }
    assert nearest(POOL, others).name == "near"
    assert nearest(POOL, others).differs_in == ("radius 0.1, 0.14",)


def test_traits_of_a_solved_fire_are_what_its_solver_was_told():
    found = {fire.name: traits(fire) for fire in EVERYTHING if fire.foam}
    pool, wind, two = (found[name] for name in ("dev/foam_pool_methane", "dev/foam_pool_wind", "test/foam_two_burners"))
    assert pool.radius == pytest.approx(0.2002 / 3.14159265**0.5)  # of a square the circle of equal area
    assert (wind.wind, wind.fuel, two.shape) == (1.2, "propane", "square + round")
    # 40 kW of methane, 50.0 MJ/kg, at 0.66 kg/m3 through a square of 16 mm
    assert found["dev/foam_jet"].jet == pytest.approx(40e3 / 50.0e6 / 0.66 / 0.016**2, rel=0.03)


def test_the_list_shows_every_fire_and_what_is_most_like_it(capsys):
    assert __main__.main(["--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for fire in EVERYTHING:
        assert sum(line.startswith(f"| {fire.name} |") for line in lines) == (2 if fire.split == "test" else 1)
    assert not any("NEAR TWINS" in line for line in lines)


# ---------------------------------------------------------------- making them


def write_fires(folder, **specs) -> None:
    for name, spec in specs.items():
        (folder / "dev").mkdir(parents=True, exist_ok=True)
        (folder / "dev" / f"{name}.json").write_text(json.dumps(spec.to_dict()))


def test_a_misnamed_or_misplaced_fire_is_refused(tmp_path):
    write_fires(tmp_path / "a", other=replace(TOY, name="toy"))
    with pytest.raises(DataFormatError, match=r"other\.json: its name is 'toy'"):
        fires("dev", tmp_path / "a")
    elsewhere = scene_spec.GridFire("somewhere/grids")
    write_fires(tmp_path / "b", toy=replace(TOY, domain=None, fire=elsewhere))
    with pytest.raises(DataFormatError, match="expected 'openfoam/<fire>/grids'"):
        fires("dev", tmp_path / "b")


def toy_fires(folder) -> list:
    """One that we simulate, and one of grids, both tiny."""
    tiny = replace(TOY, clip=replace(TOY.clip, frames=2, warm_up_frames=3), cameras=replace(TOY.cameras, count=1))
    grids = scene_spec.GridFire("openfoam/pool_methane/grids", position=(0.0, 0.0, 0.1))
    burnt = replace(tiny, name="burnt", domain=None, fire=grids, clip=replace(tiny.clip, warm_up_frames=0, fps=100.0))
    write_fires(folder, toy=tiny, burnt=burnt)
    return fires("dev", folder)


def test_fires_of_openfoam_are_left_out_where_it_is_not_installed(tmp_path, monkeypatch, capsys):
    made = []

    def no_openfoam(*_):
        raise MissingDependencyError("fireFoam is not on PATH")

    monkeypatch.setattr(making, "bake", no_openfoam)

    @contextlib.contextmanager
    def claimed(layout, spec):
        made.append(layout.root)
        layout.description.touch()
        yield

    monkeypatch.setattr(making, "claimed", claimed)
    monkeypatch.setattr(__main__, "fires", lambda split: toy_fires(tmp_path / "specs") if split == "dev" else [])
    (tmp_path / "work/dev/toy").mkdir(parents=True)
    assert __main__.main([str(tmp_path / "work")]) == 0
    assert made == [tmp_path / "work/dev/toy"]
    assert "OpenFOAM is not installed: dev/burnt" in capsys.readouterr().out


def test_the_command_asks_for_its_folder(capsys):
    assert __main__.main([]) == 1
    assert "python -m gof_benchmark.fires WORK" in capsys.readouterr().err


@pytest.mark.blender
@pytest.mark.slow
def test_one_command_makes_every_fire_once(tmp_path, monkeypatch, capsys):
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    work = tmp_path / "work"
    write_small_fire(work / "openfoam/pool_methane/grids")
    monkeypatch.setattr(__main__, "fires", lambda split: toy_fires(tmp_path / "specs") if split == "dev" else [])
    assert __main__.main([str(work), "--split", "dev"]) == 0
    for name in ("toy", "burnt"):
        dataset = Dataset.open(work / "dev" / name)
        assert dataset.image(0, 1).shape and len(dataset.velocity) == 2
    before = {path: path.stat().st_mtime_ns for path in (work / "dev").rglob("*.png")}
    capsys.readouterr()
    assert __main__.main([str(work), "--split", "dev"]) == 0
    assert capsys.readouterr().out.startswith("2 fires, about 0 s left")
    assert before == {path: path.stat().st_mtime_ns for path in (work / "dev").rglob("*.png")}
