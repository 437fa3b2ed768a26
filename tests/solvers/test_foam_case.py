"""A case of fireFoam: its description, mesh and dictionaries, asked of OpenFOAM itself where it is installed."""

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import DataFormatError, MissingDependencyError
from gof.core.records import from_json, to_json
from gof_benchmark.solvers.openfoam import run
from gof_benchmark.solvers.openfoam.__main__ import main
from gof_benchmark.solvers.openfoam.case import (
    burner_areas,
    draught,
    edges,
    write_case,
    write_control,
    write_fields,
)
from gof_benchmark.solvers.openfoam.dictionaries import named, render, write_dictionary
from gof_benchmark.solvers.openfoam.foam_fire import FIRES, FoamBurner, FoamFire, find_fire, growing
from tests.solvers.conftest import toy_fire

pytestmark = pytest.mark.long

SHIPPED = sorted(p.stem for p in FIRES.glob("*.json"))


def test_dictionaries_in_openfoams_text(tmp_path):
    assert render({"a": 1, "b": {"c": True, "d": (1, 2.5, "x")}}) == (
        "{\n    a 1;\n    b\n    {\n        c yes;\n        d (1 2.5 x);\n    }\n}\n"
    )
    assert named({"top": {"type": "patch"}}) == "(\ntop\n{\n    type patch;\n}\n)"
    write_dictionary(tmp_path / "T", {"x": 1e-7}, "volScalarField")
    text = (tmp_path / "T").read_text()
    assert "class volScalarField;" in text and "object T;" in text and "x 1e-07;" in text


def test_the_shipped_fires_differ_and_fit_their_meshes():
    assert set(SHIPPED) >= {"pool_methane", "pool_propane", "jet", "two_burners", "pool_wind"}
    burned = set()
    for name in SHIPPED:
        fire = find_fire(name)
        burned.add((str(fire.burners), fire.fuel, fire.wind_m_s))
        assert fire.name == name and from_json(FoamFire, to_json(fire), name) == fire
        assert fire.settle_s >= 0.25 and np.prod(fire.cells("fine")) < 200_000
        for area, burner in zip(burner_areas(fire, "fine"), fire.burners, strict=True):
            assert area == pytest.approx(burner.area_m2, rel=0.1)
    assert len(burned) == len(SHIPPED)


def test_heat_sets_the_flow_of_fuel():
    burner = FoamBurner(50.03, 0.1, shape="round")
    fire = toy_fire()
    assert burner.mass_flow(fire.gas) == pytest.approx(1e-3, rel=1e-3)
    assert burner.speed(fire.gas) * burner.area_m2 * fire.gas.density == pytest.approx(1e-3, rel=1e-3)
    assert FoamBurner(1, 0.2).diameter_m == pytest.approx(0.2257, abs=1e-4)


@pytest.mark.parametrize(("first", "length"), [(0.01, 0.5), (0.05, 0.06), (0.05, 0.05), (0.1, 0.03), (0.0125, 2.0)])
def test_cells_grow_smoothly_to_the_wall(first, length):
    count, ratio = growing(first, length, 1.4)
    sizes = np.geomspace(1, ratio, count) * length / np.geomspace(1, ratio, count).sum()
    assert sizes.sum() == pytest.approx(length)
    if length > 2 * first:
        assert sizes[0] == pytest.approx(first, rel=0.35) and sizes[1] / sizes[0] <= 1.4 + 1e-6


def test_the_core_is_uniform_and_lies_where_it_should():
    fire = find_fire("pool_methane")
    for i, e in enumerate(edges(fire, "fine")):
        core = e[(e > fire.core_low_m[i] - 1e-9) & (e < fire.core_high_m[i] + 1e-9)]
        np.testing.assert_allclose(np.diff(core), fire.cell_m[i], rtol=1e-9)
        assert core[0] == pytest.approx(fire.core_low_m[i]) and core[-1] == pytest.approx(fire.core_high_m[i])
        assert e[-1] == pytest.approx(fire.domain_high_m[i]) and (np.diff(e) > 0).all()


def test_the_seed_draws_the_air_and_nothing_else():
    fire = toy_fire(seed=3)
    air = draught(fire, "fine")
    assert air.shape == (np.prod(fire.cells("fine")), 3) and 0.06 < air.std() < 0.22
    np.testing.assert_array_equal(air, draught(replace(fire, name="other"), "fine"))
    assert not np.allclose(air, draught(replace(fire, seed=4), "fine"))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"burners": ()}, "burners"),
        ({"burners": (FoamBurner(-1, 0.1),)}, "heat and size"),
        ({"burners": (FoamBurner(10, 0.5),)}, "leaves the core"),
        ({"core_low_m": (-0.6, -0.2, 0.0)}, "inside the domain"),
        ({"domain_low_m": (-0.5, -0.5, -0.1)}, "z = 0"),
        ({"cell_m": (0.2, 0.2, 0.2)}, "4 cells"),
        ({"stretch": 1.0}, "stretch"),
        ({"frames": 1}, "frames"),
        ({"settle_s": 0.0}, "settle_s"),
    ],
)
def test_a_fire_that_cannot_be_is_refused_by_name(change, says):
    with pytest.raises(DataFormatError, match=says):
        toy_fire(**change)


def test_cells_too_large_for_a_burner_are_refused(tmp_path):
    with pytest.raises(DataFormatError, match="burner 0"):
        write_case(toy_fire(burners=(FoamBurner(10, 0.03),)), tmp_path, "fine")


def test_wind_comes_in_leaves_and_slides_along(tmp_path):
    write_fields(toy_fire(wind_m_s=(1.2, 0.0)), tmp_path, "fine")
    text = (tmp_path / "0" / "U").read_text()
    kinds = dict(re.findall(r"    (\w+)\n    \{\n        type (\w+);", text))
    assert kinds["west"] == "fixedValue" and kinds["east"] == "pressureInletOutletVelocity"
    assert kinds["south"] == kinds["north"] == "slip" and kinds["burner0"] == "flowRateInletVelocity"


def test_an_unknown_fire_is_named_and_so_are_those_there_are(capsys):
    assert main(["bonfire"]) == 1
    assert "pool_methane" in capsys.readouterr().err


def test_without_openfoam_the_package_is_named(monkeypatch):
    monkeypatch.setattr(run.shutil, "which", lambda name: None)
    with pytest.raises(MissingDependencyError, match="apt-get install openfoam"):
        run.find_installation()


def test_openfoam_without_its_data_is_named(monkeypatch, tmp_path):
    (tmp_path / "bin").mkdir()
    monkeypatch.setattr(run.shutil, "which", lambda name: str(tmp_path / "bin" / name))
    monkeypatch.setenv("WM_PROJECT_DIR", str(tmp_path / "gone"))
    with pytest.raises(MissingDependencyError, match="gone"):
        run.find_installation()


def ask(foam, case, program, *arguments) -> str:
    done = subprocess.run(
        [foam.program(program), *arguments], cwd=case, env=foam.environment(case), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("fire", [toy_fire(), toy_fire(fuel="propane", wind_m_s=(0.5, 0.5), les_model="WALE")])
def test_openfoam_reads_every_file(foam, tmp_path, fire):
    write_case(fire, tmp_path, "fine")
    write_control(tmp_path, fire, 0.1, 0.05)
    write_fields(fire, tmp_path, "fine")
    files = [f for d in ("system", "constant", "0") for f in (tmp_path / d).iterdir()]
    assert len(files) > 25
    for file in files:
        assert ask(foam, tmp_path, "foamDictionary", "-keywords", str(file)).split(), file
    assert ask(foam, tmp_path, "foamDictionary", "-entry", "maxCo", "-value", "system/controlDict").strip() == str(
        fire.courant
    )


@pytest.mark.parametrize("name", ["toy", *SHIPPED])
@pytest.mark.parametrize("level", ["coarse", "fine"])
def test_openfoam_makes_the_mesh_we_describe(foam, tmp_path, name, level):
    fire = toy_fire() if name == "toy" else find_fire(name)
    write_case(fire, tmp_path, level)
    write_control(tmp_path, fire, 0.1, 0.05)
    ask(foam, tmp_path, "blockMesh")
    ask(foam, tmp_path, "topoSet")
    ask(foam, tmp_path, "createPatch", "-overwrite")
    report = ask(foam, tmp_path, "checkMesh")
    assert "Mesh OK." in report and f"cells:            {np.prod(fire.cells(level))}\n" in report
    boundary = (tmp_path / "constant" / "polyMesh" / "boundary").read_text()
    ex, ey, _ = edges(fire, level)
    for i, area in enumerate(burner_areas(fire, level)):
        faces = int(re.search(rf"burner{i}\s*\{{[^}}]*nFaces\s+(\d+)", boundary).group(1))
        cell = np.diff(ex).min() * np.diff(ey).min()
        assert faces == round(area / cell)
    points = read_points(tmp_path / "constant" / "polyMesh" / "points")
    for axis, expected in zip(points.T, edges(fire, level), strict=True):
        np.testing.assert_allclose(np.unique(axis.round(9)), expected, atol=2e-8)


def read_points(path) -> np.ndarray:
    data = path.read_bytes()
    found = re.search(rb"\n(\d+)\s*\(", data)
    return np.frombuffer(data, "<f8", 3 * int(found.group(1)), found.end()).reshape(-1, 3)
