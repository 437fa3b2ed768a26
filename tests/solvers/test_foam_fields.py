"""Reading OpenFOAM's fields, putting them on a uniform grid, and the light of them."""

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof_benchmark.solvers.openfoam.chemistry import AMBIENT_K, FUELS, MOLAR_MASS, NASA, enthalpy, reactions
from gof_benchmark.solvers.openfoam.fields import (
    Resampler,
    add_to_internal,
    frame_folder,
    luminous_emission,
    on_mesh,
    planck,
    read_internal,
    soot_share,
)
from tests.solvers.conftest import toy_fire

HEADER = """FoamFile
{{
    version     2.0;
    format      {form};
    class       vol{kind}Field;
    arch        "{arch}";
    location    "0.5";
    object      U;
}}
dimensions      [0 1 -1 0 0 0 0];

internalField   nonuniform List<{item}>
{count}
("""
ARCH = "LSB;label=32;scalar=64"


def binary(values: np.ndarray, arch=ARCH) -> bytes:
    """A field as OpenFOAM writes it in binary, by hand."""
    kind, item = ("Vector", "vector") if values.ndim == 2 else ("Scalar", "scalar")
    order = ">f8" if arch.startswith("MSB") else "<f8"
    header = HEADER.format(form="binary", kind=kind, item=item, count=len(values), arch=arch)
    return header.encode() + values.astype(order).tobytes() + b")\n;\n\nboundaryField\n{\n}\n\n// ***** //\n"


@pytest.mark.parametrize("shape", [(7,), (7, 3)])
@pytest.mark.parametrize("arch", [ARCH, "MSB;label=32;scalar=64"])
def test_binary_fields_are_read_exactly(tmp_path, shape, arch):
    values = np.random.default_rng(0).normal(size=shape)
    values.flat[0] = np.frombuffer(b")\n;\x00(; }", "<f8")[0]  # bytes that look like text must not end the list
    (tmp_path / "U").write_bytes(binary(values, arch))
    np.testing.assert_array_equal(read_internal(tmp_path / "U", 7), values)


@pytest.mark.parametrize("values", ["(1 2 nan)", "(1 2 inf)", "(1 2 x)", "(1 2 -)", "(1 2)", "(1 2 3 4)"])
def test_text_that_is_no_finite_numbers_is_refused(tmp_path, values):
    header = HEADER.format(form="ascii", kind="Vector", item="vector", count=2, arch=ARCH)
    uniform = header[: header.index("nonuniform")] + f"uniform {values};\n"
    for text in (header + f"\n(1 2 3)\n{values}\n)\n;\n", uniform):
        (tmp_path / "U").write_text(text)
        with pytest.raises(DataFormatError, match=r"U: "):
            read_internal(tmp_path / "U", 2)


def test_binary_values_that_are_not_finite_are_refused(tmp_path):
    (tmp_path / "U").write_bytes(binary(np.array([1, np.nan])))
    with pytest.raises(DataFormatError, match="NaN"):
        read_internal(tmp_path / "U", 2)


def test_text_and_uniform_fields_are_read(tmp_path):
    header = HEADER.format(form="ascii", kind="Vector", item="vector", count=2, arch=ARCH)
    (tmp_path / "U").write_text(header + "\n(1 2 3)\n(4 5 6)\n)\n;\n")
    np.testing.assert_array_equal(read_internal(tmp_path / "U", 2), [[1, 2, 3], [4, 5, 6]])
    head = header[: header.index("nonuniform")]
    (tmp_path / "V").write_text(head + "uniform (0 0 1.5);\n")
    np.testing.assert_array_equal(read_internal(tmp_path / "V", 2), [[0, 0, 1.5]] * 2)
    (tmp_path / "T").write_text(head.replace("Vector", "Scalar") + "uniform 300;\n")
    np.testing.assert_array_equal(read_internal(tmp_path / "T", 3), [300] * 3)


def test_a_field_is_shaken_in_place_and_nothing_else_changes(tmp_path):
    values, shake = np.random.default_rng(0).normal(size=(2, 7, 3))
    (tmp_path / "U").write_bytes(binary(values))
    before = (tmp_path / "U").read_bytes()
    add_to_internal(tmp_path / "U", shake)
    np.testing.assert_array_equal(read_internal(tmp_path / "U", 7), values + shake)
    add_to_internal(tmp_path / "U", -shake)
    after = (tmp_path / "U").read_bytes()
    assert len(after) == len(before) and after.endswith(before[-50:]) and after.startswith(before[:200])
    (tmp_path / "T").write_text(
        HEADER.format(form="ascii", kind="Scalar", item="scalar", count=2, arch=ARCH) + "1 2)\n;"
    )
    with pytest.raises(DataFormatError, match="not a binary list"):
        add_to_internal(tmp_path / "T", np.ones(2))


def test_what_is_wrong_with_a_field_is_named(tmp_path):
    path = tmp_path / "U"
    with pytest.raises(DataFormatError, match="cannot be read"):
        read_internal(path, 3)
    path.write_text("not a field")
    with pytest.raises(DataFormatError, match="not a field of OpenFOAM"):
        read_internal(path, 3)
    values = np.ones((5, 3))
    path.write_bytes(binary(values))
    with pytest.raises(DataFormatError, match="another case"):
        read_internal(path, 6)
    path.write_bytes(binary(values)[:300])
    with pytest.raises(DataFormatError, match="cut off"):
        read_internal(path, 5)
    path.write_bytes(binary(values, "LSB;label=32;scalar=32"))
    with pytest.raises(DataFormatError, match="8-byte"):
        read_internal(path, 5)


def test_cells_run_along_x_first():
    values = np.arange(2 * 3 * 4)
    grid = on_mesh(values, (2, 3, 4))
    assert grid.shape == (2, 3, 4) and grid[1, 0, 0] == 1 and grid[0, 1, 0] == 2 and grid[0, 0, 1] == 6
    vectors = on_mesh(np.stack([values, -values, 2 * values], 1), (2, 3, 4))
    np.testing.assert_array_equal(vectors[..., 1], -grid)


def test_resampling_keeps_a_linear_field_exactly():
    rng = np.random.default_rng(1)
    edges = [np.concatenate([[0], np.cumsum(rng.uniform(0.02, 0.2, 12))]) for _ in range(3)]
    high = [min(e[-2], 0.8) for e in edges]
    resample = Resampler(edges, [e[1] for e in edges], high, 0.03)
    x, y, z = np.meshgrid(*[(e[1:] + e[:-1]) / 2 for e in edges], indexing="ij")
    found = resample(np.stack([1 + 2 * x - y, 3 * z, x + y + z], -1))
    index = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in resample.shape], indexing="ij"), -1)
    p = index @ resample.index_to_world[:3, :3].T + resample.index_to_world[:3, 3]
    inside = np.all([(p[..., i] >= (edges[i][0] + edges[i][1]) / 2) for i in range(3)], axis=0)
    expected = np.stack([1 + 2 * p[..., 0] - p[..., 1], 3 * p[..., 2], p.sum(-1)], -1)
    assert inside.mean() > 0.9
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-12)


def test_resampling_to_the_mesh_itself_changes_nothing():
    edges = [np.linspace(0, 0.4, 5)] * 3
    values = np.random.default_rng(2).normal(size=(4, 4, 4))
    resample = Resampler(edges, [0, 0, 0], [0.4] * 3, 0.1)
    np.testing.assert_allclose(resample(values), values, atol=1e-12)


def test_a_frames_folder_is_found_by_time(tmp_path):
    fire = toy_fire()
    for name in ("0", "0.15", "0.16", "constant"):
        (tmp_path / name).mkdir()
    assert frame_folder(fire, tmp_path, 1).name == "0.16"
    with pytest.raises(DataFormatError, match="frame 2"):
        frame_folder(fire, tmp_path, 2)


@pytest.mark.parametrize("law", ["polynomial", "planck"])
@pytest.mark.parametrize("fuel", FUELS.values())
def test_light_grows_with_temperature_and_needs_fuel(law, fuel):
    t = np.linspace(300, 2200, 100)
    rich = np.full(100, 2 * fuel.stoichiometric_mixture_fraction)
    light = luminous_emission(t, rich, fuel, law)
    assert light.shape == (100, 3) and (light >= 0).all() and np.isfinite(light).all()
    assert (np.diff(light, axis=0) >= 0).all() and light[-1, 0] > light[-1, 1] > light[-1, 2] > 0
    assert (luminous_emission(t, np.zeros(100), fuel, law) == 0).all()
    growing = luminous_emission(np.full(50, 1500.0), np.linspace(0, 0.3, 50), fuel, law)[:, 0]
    assert (np.diff(growing) >= 0).all()
    assert luminous_emission(np.array(1500.0), -0.01, fuel, law).max() == 0  # a little below 0: the solver's rounding


def test_both_laws_agree_on_a_cell_full_of_flame():
    fuel, t = FUELS["methane"], np.array([1800.0])
    np.testing.assert_allclose(
        luminous_emission(t, np.array([0.2]), fuel, "polynomial"), luminous_emission(t, np.array([0.2]), fuel, "planck")
    )


def test_plancks_figures():
    # 2 h c^2 / lambda^5 / (exp(h c / (lambda k T)) - 1) at 550 nm, 1800 K, by the constants' own values
    h, c, k = 6.62607015e-34, 299792458.0, 1.380649e-23
    exact = 2 * h * c**2 / 550e-9**5 / np.expm1(h * c / (550e-9 * k * 1800)) * 1e-9
    assert planck(np.array(1800.0))[1] == pytest.approx(exact, rel=1e-6)
    assert (planck(np.array([0.0, -5.0])) < 1e-20).all()


def test_soot_needs_more_fuel_than_half_of_stoichiometric():
    fuel = FUELS["propane"]
    share = soot_share(fuel.stoichiometric_mixture_fraction * np.array([0.5, 1.0, 1.5, 9.0]), fuel)
    np.testing.assert_allclose(share, [0, 0.5, 1, 1])


def test_heats_of_combustion_are_those_of_the_tables():
    assert FUELS["methane"].heat_of_combustion == pytest.approx(50.03e6, rel=2e-3)
    assert FUELS["propane"].heat_of_combustion == pytest.approx(46.35e6, rel=2e-3)
    assert FUELS["methane"].stoichiometric_mixture_fraction == pytest.approx(0.0552, abs=5e-4)
    assert FUELS["propane"].density == pytest.approx(1.83, rel=0.01)


@pytest.mark.parametrize("gas", NASA)
def test_heat_capacities_join_at_1000_k_and_are_those_of_real_gases(gas):
    below, above = (enthalpy(gas, 1000 + d) for d in (-1e-6, 1e-6))
    assert below == pytest.approx(above, abs=30)  # J/mol; a slip in a coefficient is thousands
    capacity = (enthalpy(gas, 301) - enthalpy(gas, 299)) / 2
    real = {"O2": 29.4, "N2": 29.1, "H2O": 33.6, "CO2": 37.2, "CH4": 35.7, "C3H8": 73.9}  # J/(mol K) at 300 K
    assert capacity == pytest.approx(real[gas], rel=0.015)
    hot = (enthalpy(gas, 1501) - enthalpy(gas, 1499)) / 2
    real = {"O2": 36.5, "N2": 34.8, "H2O": 47.1, "CO2": 58.4, "CH4": 90.4, "C3H8": 205.9}  # at 1500 K
    assert hot == pytest.approx(real[gas], rel=0.03)


@pytest.mark.parametrize("fuel", FUELS.values())
def test_mass_is_kept_by_the_reaction_and_carbon_names_the_fuel(fuel):
    oxygen = fuel.oxygen * MOLAR_MASS["O2"]
    products = fuel.carbon * MOLAR_MASS["CO2"] + fuel.hydrogen / 2 * MOLAR_MASS["H2O"]
    assert MOLAR_MASS[fuel.species] + oxygen == pytest.approx(products, rel=1e-4)
    burnt = fuel.carbon * MOLAR_MASS["CO2"] / MOLAR_MASS[fuel.species]  # kg CO2 per kg of fuel
    assert fuel.mixture_fraction(0.0, 0.01 * burnt) == pytest.approx(0.01)
    assert fuel.mixture_fraction(0.01, 0.0) == pytest.approx(0.01)
    assert fuel.species in reactions(fuel)["species"] and AMBIENT_K > 0
