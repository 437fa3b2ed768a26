"""Results that a reader must read, and those that it must refuse: written without gof, read by gof and the add-on."""

import json
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof_blender.core.errors import GofError as AddonError
from gof_blender.pure.io import cloud
from tests.conformance import READ_NPZ, READ_PLY, REFUSE_NPZ, REFUSE_PLY, write

READ = [f"{name}.npz" for name in READ_NPZ] + [f"{name}.ply" for name in READ_PLY]
REFUSE = [f"{name}.npz" for name in REFUSE_NPZ] + [f"{name}.ply" for name in REFUSE_PLY] + ["cut_off.npz"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    found = tmp_path_factory.mktemp("conformance")
    write(found)
    assert {path.name for path in (found / "read").iterdir()} == {*READ, "expected.json"}
    assert {path.name for path in (found / "refuse").iterdir()} == set(REFUSE)
    return found


def expected(folder: Path, name: str) -> dict:
    return json.loads((folder / "read" / "expected.json").read_text(encoding="utf-8"))[name]


@pytest.mark.parametrize("name", READ)
def test_gof_reads_it(folder, name):
    wanted = expected(folder, name)
    g = TransientGaussians.load(folder / "read" / name)
    for state in wanted["states"]:
        age = np.where(g.dynamic, state["time_s"] - g.t_mu, 0.0)
        place = g.position + age[:, None] * g.velocity
        np.testing.assert_allclose(place, state["position"], atol=1e-6)
        np.testing.assert_allclose(g.opacity * np.exp(-0.5 * (age / g.t_sigma) ** 2), state["opacity"], atol=1e-6)
    gas = g.velocity if g.gas_velocity is None else g.gas_velocity
    np.testing.assert_allclose(gas, wanted["gas_velocity"], atol=1e-6)
    sd = [np.inf if value is None else value for value in wanted["velocity_sd"]]
    np.testing.assert_allclose(g.velocity_sd, sd, atol=1e-6)
    color = g.color if g.color.ndim == 2 else 0.5 + 0.28209479 * g.color[:, 0]
    np.testing.assert_allclose(color, wanted["color"], atol=1e-6)
    assert g.emissive is wanted["emissive"]
    assert (g.datum.numbers().tolist() if g.datum else None) == wanted.get("datum")


@pytest.mark.parametrize("name", READ)
def test_the_addon_reads_it(folder, name):
    wanted, found = expected(folder, name), cloud.load(folder / "read" / name)
    for state in wanted["states"]:
        age = np.where(found.dynamic, state["time_s"] - found.t_mu, 0.0)
        np.testing.assert_allclose(found.position + age[:, None] * found.velocity, state["position"], atol=1e-6)
    np.testing.assert_allclose(found.moving_gas, wanted["gas_velocity"], atol=1e-6)
    assert found.emissive is wanted["emissive"]
    assert (found.datum.numbers().tolist() if found.datum else None) == wanted.get("datum")


@pytest.mark.parametrize("name", REFUSE)
def test_both_refuse_it(folder, name):
    for read in (TransientGaussians.load, cloud.load):
        with pytest.raises((GofError, AddonError), match=name):
            read(folder / "refuse" / name)
