"""OpenUSD read: our own files against the Gaussians they were made of, and stages that OpenUSD's library wrote here,
against motion that is known in closed form."""

import json
import subprocess
import sys
import types

import numpy as np
import pytest

from gof.commands.convert import main
from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError, MissingDependencyError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0, basis
from gof.core.rotations import rotation_matrices
from gof.core.trajectory import Trajectory
from gof.io import usd
from gof.io.importers import ImportOptions, read_result, usd_crate
from tests.conftest import random_gaussians
from tests.io import stages

START_S, END_S, STEP_S = 0.1, 0.4, 0.05
N = 12


def moving(n=200, **changes) -> TransientGaussians:
    """Gaussians of every kind: some still, some always on, some of unknown uncertainty."""
    g, rng = random_gaussians(n), np.random.default_rng(2)
    spread = np.where(rng.random(n) < 0.3, np.inf, rng.uniform(0.1, 2, n))
    extra = {"gas_velocity": rng.normal(0, 2, (n, 3)), "velocity_sd": spread, "opacity": rng.uniform(0.5, 1, n)}
    datum = changes.pop("datum", None)
    return TransientGaussians(**g.arrays() | extra | changes, datum=datum)


def written(folder, g, name="a.usda"):
    """The Gaussians that the file holds, and the file."""
    seen, _ = usd.save(g, folder / name, START_S, END_S, STEP_S, "gof: result.npz")
    return g[seen], folder / name


# ---------------------------------------------------------------- ours


@pytest.mark.parametrize("name", ["a.usda", "a.usdc"])
def test_our_closed_form_comes_back(tmp_path, name):
    stages.openusd()
    color = np.random.default_rng(3).normal(0, 0.4, (200, 9, 3))
    g, path = written(tmp_path, moving(color=color, datum=Datum((5e5, 4e6, 100.0), 1.7e9)), name)
    imported = read_result(path)
    back = imported.gaussians
    assert imported.method == "gof" and imported.notes == [] and back.datum == g.datum
    moves = g.dynamic
    np.testing.assert_array_equal(back.dynamic, moves)
    assert 1e3 * np.abs(back.velocity - g.velocity)[moves].max() < 1e-3, "mm/s: seven digits of metres per second"
    np.testing.assert_allclose(back.gas_velocity[moves], g.gas_velocity[moves], rtol=6e-7)
    assert not back.velocity[~moves].any() and not back.gas_velocity[~moves].any()
    np.testing.assert_allclose(back.velocity_sd, g.velocity_sd, rtol=6e-7)
    np.testing.assert_allclose(back.t_mu[moves], g.t_mu[moves], rtol=6e-7)
    np.testing.assert_allclose(back.t_sigma[moves], g.t_sigma[moves], rtol=6e-7)
    assert 1e3 * np.abs(back.position - g.position).max() < 2e-3, "mm"
    np.testing.assert_allclose(back.color, g.color, rtol=6e-7)
    np.testing.assert_allclose(back.scale, g.scale, rtol=6e-7)
    np.testing.assert_allclose(back.rotation, g.rotation, atol=2e-7)
    later = read_result(path, ImportOptions(time_zero_s=2.0)).gaussians
    np.testing.assert_allclose(later.t_mu[moves], g.t_mu[moves] + 2, atol=1e-6)
    with pytest.raises(DataFormatError, match="--time-unit would change nothing"):
        read_result(path, ImportOptions(time_unit_s=2.0))


def test_gof_convert_there_and_back(tmp_path):
    stages.openusd()
    g = moving(60, dynamic=np.ones(60, bool), t_sigma=np.full(60, 0.1), t_mu=np.linspace(0.1, 0.4, 60))
    g.save(tmp_path / "a.npz", "gof reconstruct made up")
    words = ["--frame-time", "0.05", "--clip", "0.1", "0.4", "--json", str(tmp_path / "j")]
    assert main([str(tmp_path / "a.npz"), str(tmp_path / "a.usdc"), *words]) == 0
    said = " ".join(json.loads((tmp_path / "j").read_text())["notes"])
    assert float(said.split("velocities ")[1].split(" mm/s")[0]) < 1e-3 and float(said.split("agree to ")[1][:4]) > 90
    assert main([str(tmp_path / "a.usdc"), str(tmp_path / "b.npz")]) == 0
    back = TransientGaussians.load(tmp_path / "b.npz")
    np.testing.assert_allclose(back.position, g.position, atol=2e-6)
    np.testing.assert_allclose(back.color, g.color, atol=1e-6)
    assert read_result(tmp_path / "b.npz").method == "gof", "drawn over plates, as what it was made of"


def test_a_frame_of_ours_is_enough(tmp_path):
    stages.openusd()
    usd.save(moving(), tmp_path / "one.usda", 0.2, 0.2, 0.05)
    assert read_result(tmp_path / "one.usda").gaussians.velocity.any()


def test_ours_in_another_scene_is_read_from_its_samples(tmp_path):
    """Turned, twice as large, in centimetres, beside a background; its gas velocity is scored, as here."""
    stages.openusd()
    from pxr import UsdGeom

    g, _ = written(tmp_path, moving(dynamic=np.ones(200, bool)))
    stage = stages.new(tmp_path / "scene.usdc", up="Y", metres=0.01, rate=1 / STEP_S)
    holder = UsdGeom.Xform.Define(stage, "/there")
    holder.AddScaleOp().Set((200, 200, 200))
    stage.OverridePrim("/there/flame").GetReferences().AddReference("a.usda")
    stages.splats(stage, "/wall", {}, positions=np.zeros((3, 3)), scales=np.ones((3, 3)))
    stage.Save()
    imported = read_result(tmp_path / "scene.usdc", ImportOptions(time_zero_s=START_S))
    back = imported.gaussians
    assert imported.method == "usd" and any("another scene" in note for note in imported.notes)
    np.testing.assert_array_equal(back.dynamic, np.arange(len(g) + 3) < len(g))
    for k in (0, 3, 6):
        time_s = START_S + k * STEP_S
        state, place = back.state_at(time_s), g.at(time_s)[0] * 2
        np.testing.assert_allclose(
            state.position[: len(g)], np.stack([place[:, 0], -place[:, 2], place[:, 1]], 1), atol=2e-5
        )
        v = 2 * g.gas_velocity
        np.testing.assert_allclose(state.velocity[: len(g)], np.stack([v[:, 0], -v[:, 2], v[:, 1]], 1), atol=1e-4)


def test_ours_that_was_retimed_is_read_from_its_samples(tmp_path):
    stages.openusd()
    _, path = written(tmp_path, moving(dynamic=np.ones(200, bool), gas_velocity=None))
    text = path.read_text()
    path.write_text(text.replace("timeCodesPerSecond = 20.0", "timeCodesPerSecond = 40.0"))
    imported = read_result(path)
    assert any("has it been changed?" in note for note in imported.notes)
    assert isinstance(imported.gaussians, Trajectory) and imported.gaussians.covered_s == pytest.approx((0, 0.15))
    assert any("differ from its places' differences by 50%" in note for note in imported.notes), "half as fast"


# ---------------------------------------------------------------- everybody's


def ways(seed=0):
    """Places that are quadratic in time: three-point differences of them are exact."""
    x0, v0, a = np.random.default_rng(seed).normal(size=(3, N, 3))
    return lambda t: x0 + v0 * t + 0.5 * a * t**2, lambda t: v0 + a * t


def plain(count=N):
    return {"scales": np.full((count, 3), 0.1), "opacities": np.full(count, 0.5)}


def test_units_axes_clock_hierarchy_and_colours_of_another_program(tmp_path):
    """Centimetres, y up, from time code 1001 on, under a turned, scaled and moved parent; quaternions of any length."""
    stages.openusd()
    from pxr import UsdGeom

    place, velocity = ways()
    rng = np.random.default_rng(1)
    turn, sh = rng.normal(size=(N, 4)) * 3, rng.normal(0, 0.3, (N, 4, 3))
    stage = stages.new(tmp_path / "a.usdc", up="Y", metres=0.01, rate=24.0, start=1001)
    parent = UsdGeom.Xform.Define(stage, "/rig")
    parent.AddTranslateOp().Set((10, 20, 30))
    parent.AddRotateZOp().Set(90)
    parent.AddScaleOp().Set((2, 2, 2))
    samples = {1001 + k: {"positions": place(k / 24)} for k in range(6)}
    size = rng.uniform(0.1, 0.3, (N, 3))
    still = {"scales": size, "opacities": np.full(N, 0.5), "orientations": turn, "sh": sh.reshape(-1, 3), "degree": 1}
    stages.splats(stage, "/rig/fire", samples, **still)
    stage.Save()
    imported = read_result(tmp_path / "a.usdc", ImportOptions(time_zero_s=5.0))
    assert any("time code 1001 taken as 5 s, and 24 codes" in note for note in imported.notes)
    assert any("y up, 0.01 m a unit (else" in note for note in imported.notes)
    to_z_up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    R = to_z_up @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for k in (0, 2, 5):
        state = imported.gaussians.state_at(5 + k / 24)
        wanted = 0.01 * (2 * place(k / 24) @ R.T + to_z_up @ [10, 20, 30])
        np.testing.assert_allclose(state.position, wanted, atol=1e-6)
        np.testing.assert_allclose(state.velocity, 0.02 * velocity(k / 24) @ R.T, atol=3e-5)
    axes, own = R @ rotation_matrices(turn), rotation_matrices(state.rotation.astype(float))
    spread = axes @ (np.eye(3) * (0.02 * size[:, None]) ** 2) @ axes.transpose(0, 2, 1)
    found = own @ (np.eye(3) * state.scale[:, None].astype(float) ** 2) @ own.transpose(0, 2, 1)
    np.testing.assert_allclose(found, spread, rtol=1e-4, atol=1e-10)
    direction = np.array([0.48, -0.6, 0.64])  # theirs
    seen = np.einsum("k,nkc->nc", np.array(basis(1, direction)), sh)
    turned = np.einsum("k,nkc->nc", np.array(basis(1, R @ direction)), state.color)
    np.testing.assert_allclose(turned, seen, atol=1e-5)


def test_what_is_not_authored_is_as_usd_has_it(tmp_path):
    """24 codes a second, centimetres, y up; opaque, unturned; display colours are linear light; halves of floats."""
    stages.openusd()
    stage = stages.new(tmp_path / "a.usda", up=None, metres=None, rate=None)
    samples = {k: {"positions": np.full((2, 3), k)} for k in (0, 1, 2)}
    linear = [[0.2140411, 1, 0], [1, 0.0, 0.2140411]]  # 0.5 as sRGB shows it
    stages.splats(stage, "/a", samples, scalesh=np.full((2, 3), 0.5), **{"primvars:displayColor": linear})
    stage.Save()
    imported = read_result(tmp_path / "a.usda")
    g = imported.gaussians.state_at(1 / 24)
    np.testing.assert_allclose(g.velocity, np.tile([0.24, -0.24, 0.24], (2, 1)), rtol=1e-5)
    np.testing.assert_allclose(g.color, [[0.5, 1, 0], [1, 0, 0.5]], atol=1e-6)
    np.testing.assert_allclose(g.scale, 0.005, rtol=1e-6)
    np.testing.assert_allclose(g.opacity, 1)
    said = " ".join(imported.notes)
    assert "where a file says nothing" in said and "no opacities" in said and "displayColor" in said
    stage = stages.new(tmp_path / "grey.usda")
    stages.splats(stage, "/a", samples, **plain(2))
    stage.Save()
    np.testing.assert_allclose(read_result(tmp_path / "grey.usda").gaussians.color, 0.5)


def test_seconds_of_a_time_code_can_be_said_and_must_where_the_clip_is_another(tmp_path):
    stages.openusd()
    place, velocity = ways()
    stage = stages.new(tmp_path / "a.usda", rate=24.0)
    samples = {k: {"positions": place(k / 24), "velocities": velocity(k / 24)} for k in range(6)}
    stages.splats(stage, "/a", samples, **plain())
    stage.Save()
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "a.usda", ImportOptions(clip_s=(0.0, 0.05)))
    g = read_result(tmp_path / "a.usda", ImportOptions(time_unit_s=0.01, clip_s=(0.0, 0.05))).gaussians
    assert g.covered_s == pytest.approx((0, 0.05))
    np.testing.assert_allclose(g.state_at(0.03).velocity, velocity(3 / 24) / 0.24, atol=1e-4)


def test_stored_velocities_go_before_differences(tmp_path):
    """And stand as they are where the motion has a kink, which differences would smooth."""
    stages.openusd()
    stage = stages.new(tmp_path / "a.usda")
    kink = {k: np.where(k < 2, 3.0, -1.0) * np.ones((N, 3)) for k in range(5)}
    samples = {k: {"positions": 0.02 * (3 * min(k, 2) - max(k - 2, 0)) * np.ones((N, 3)), "velocities": v}
               for k, v in kink.items()}  # fmt: skip
    stages.splats(stage, "/a", samples, **plain())
    stage.Save()
    imported = read_result(tmp_path / "a.usda")
    assert "velocities as stored" in imported.notes
    for k in (0, 1, 2, 4):
        np.testing.assert_allclose(imported.gaussians.state_at(0.02 * k).velocity, kink[k])
    stage = stages.new(tmp_path / "zeros.usda")
    place, velocity = ways()
    zeros = {k: {"positions": place(0.02 * k), "velocities": np.zeros((N, 3))} for k in range(5)}
    stages.splats(stage, "/a", zeros, **plain())
    stage.Save()
    imported = read_result(tmp_path / "zeros.usda")
    np.testing.assert_allclose(imported.gaussians.state_at(0.04).velocity, velocity(0.04), atol=1e-4)
    assert any("all 0 although" in note for note in imported.notes)


def test_a_transform_that_moves_moves_the_splats(tmp_path):
    """A still prim on a turning table, with and without velocities of its own: v = dR/dt x + R v."""
    stages.openusd()
    from pxr import UsdGeom

    x = np.random.default_rng(0).normal(size=(N, 3))
    for own in (0.0, 0.5):
        stage = stages.new(tmp_path / f"{own}.usda", rate=1000.0)
        table = UsdGeom.Xform.Define(stage, "/table")
        spin = table.AddRotateZOp()
        samples = {}
        for k in range(9):
            spin.Set(float(k), k)  # a degree a time code
            samples[k] = {"positions": x + [0, 0, own * k / 1000]}
            samples[k] |= {"velocities": np.full((N, 3), [0, 0, own])} if own else {}
        stages.splats(stage, "/table/a", samples, **plain())
        stage.Save()
        g = read_result(tmp_path / f"{own}.usda").gaussians
        for k in (0, 4, 8):
            angle, omega = np.deg2rad(k), np.deg2rad(1000.0)
            c, s = np.cos(angle), np.sin(angle)
            place = x @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [0, 0, own * k / 1000]
            wanted = omega * np.stack([-place[:, 1], place[:, 0], 0 * place[:, 0]], 1) + [0, 0, own]
            np.testing.assert_allclose(g.state_at(k / 1000).position, place, atol=1e-6)
            np.testing.assert_allclose(g.state_at(k / 1000).velocity, wanted, atol=2e-3 * omega)


def some(k):
    """Rows of N that live at time code k, in an order that changes."""
    rows = [n for n in range(N) if n % 4 <= k <= n % 4 + 3]
    return np.array(rows[::-1] if k % 2 else rows)


@pytest.mark.parametrize("stored", [False, True])
def test_gaussians_that_come_and_go_are_followed_by_their_ids(tmp_path, stored):
    stages.openusd()
    x0, v = np.random.default_rng(3).normal(size=(2, N, 3))
    stage, ids = stages.new(tmp_path / "a.usdc"), 100 + 7 * np.arange(N)
    samples = {}
    for k in range(7):
        row = some(k)
        size, clear = 0.1 + 0.01 * row[:, None] * np.ones(3), 0.05 * row + 0.1
        samples[k] = {
            "positions": (x0 + v * 0.02 * k)[row],
            "scales": size,
            "opacities": clear,
            "primvars:id": ids[row],
        }
        samples[k] |= {"velocities": v[row]} if stored else {}
    stages.splats(stage, "/a", samples)
    stage.Save()
    g = read_result(tmp_path / "a.usdc").gaussians
    assert len(g) == N
    for k in range(7):
        state, row = g.state_at(0.02 * k), some(k)
        np.testing.assert_allclose(state.position[row], (x0 + v * 0.02 * k)[row], atol=1e-6)
        np.testing.assert_allclose(state.velocity[row], v[row], atol=2e-5)
        np.testing.assert_allclose(state.opacity[row], 0.05 * row + 0.1, atol=1e-6)
        np.testing.assert_allclose(state.scale[row, 0], 0.1 + 0.01 * row, atol=1e-6)
        assert not np.delete(state.opacity, row).any(), "what is not there is not seen"


def test_ids_in_another_order_an_empty_sample_and_an_empty_prim(tmp_path):
    """Sizes that hold at all times count by place in the array, so they go with the order, not with the ids."""
    stages.openusd()
    x0, v = np.random.default_rng(3).normal(size=(2, 4, 3))
    stage, size = stages.new(tmp_path / "a.usda"), np.linspace(0.1, 0.4, 4)
    samples = {k: {"positions": (x0 + v * 0.02 * k)[np.roll(np.arange(4), k)]} for k in range(5)}
    for k in samples:
        samples[k] |= {"primvars:id": np.roll(np.arange(4), k)}
    still = {"scales": np.tile(size[:, None], 3), "opacities": np.full(4, 0.5)}
    stages.splats(stage, "/a", samples, **still)
    stages.splats(stage, "/none", {}, positions=np.zeros((0, 3)))
    stage.Save()
    imported = read_result(tmp_path / "a.usda")
    assert any("/none: holds no Gaussian" in note for note in imported.notes)
    for k in range(5):
        state = imported.gaussians.state_at(0.02 * k)
        np.testing.assert_allclose(state.position, x0 + v * 0.02 * k, atol=1e-6)
        np.testing.assert_allclose(state.velocity, v, atol=2e-5)
        np.testing.assert_allclose(state.scale[np.roll(np.arange(4), k), 0], size, atol=1e-6)
    stage = stages.new(tmp_path / "late.usda")
    late = {k: {"positions": x0 + v * 0.02 * k, "primvars:id": np.arange(4), **plain(4)} for k in range(1, 5)}
    empty = {"positions": [], "scales": [], "opacities": []}
    stages.splats(stage, "/a", {0: empty} | late)
    stage.Save()
    g = read_result(tmp_path / "late.usda").gaussians
    assert not g.opacity[0].any()
    np.testing.assert_allclose(g.state_at(0.02).velocity, v, atol=2e-5)


def test_gaussians_without_ids_may_change_their_number_where_velocities_are_stored(tmp_path):
    stages.openusd()
    x0, v = np.random.default_rng(3).normal(size=(2, N, 3))
    for name in ("with", "without"):
        stage = stages.new(tmp_path / f"{name}.usda")
        samples = {k: {"positions": (x0 + v * 0.02 * k)[some(k)], **plain(len(some(k)))} for k in range(7)}
        for k in samples:
            samples[k] |= {"velocities": v[some(k)]} if name == "with" else {}
        stages.splats(stage, "/a", samples)
        stage.Save()
    imported = read_result(tmp_path / "with.usda")
    for k in range(7):
        state = imported.gaussians.state_at(0.02 * k)
        seen = state.opacity > 0
        np.testing.assert_allclose(state.position[seen], (x0 + v * 0.02 * k)[some(k)], atol=1e-6)
        np.testing.assert_allclose(state.velocity[seen], v[some(k)], atol=1e-6)
    with pytest.raises(DataFormatError, match="/a: its samples hold 3 to 12 Gaussians and no ids.*'velocities'"):
        read_result(tmp_path / "without.usda")


def test_several_prims_instances_and_what_pictures_do_not_show(tmp_path):
    """A flame twice by an instance, a still wall as background, a proxy left out, one that is hidden for a while."""
    stages.openusd()
    from pxr import UsdGeom

    place, velocity = ways()
    stage = stages.new(tmp_path / "a.usda")
    prototype = stage.CreateClassPrim("/proto")
    samples = {k: {"positions": place(0.02 * k)} for k in range(5)}
    stages.splats(stage, "/proto/flame", samples, **plain())
    for n in range(2):
        copy = UsdGeom.Xform.Define(stage, f"/copy{n}")
        copy.AddTranslateOp().Set((10.0 * n, 0, 0))
        copy.GetPrim().GetReferences().AddInternalReference(prototype.GetPath())
        copy.GetPrim().SetInstanceable(True)
    stages.splats(stage, "/wall", {}, positions=np.zeros((3, 3)), sh=np.full((12, 3), 0.1), degree=1, **plain(3))
    blinks = UsdGeom.Imageable(stages.splats(stage, "/blinks", {}, positions=np.zeros((2, 3)), **plain(2)))
    for k in range(5):
        blinks.GetVisibilityAttr().Set("invisible" if k == 2 else "inherited", k)
    proxy = stages.splats(stage, "/low", samples, **plain())
    UsdGeom.Imageable(proxy).GetPurposeAttr().Set("proxy")
    stage.Save()
    imported = read_result(tmp_path / "a.usda")
    g = imported.gaussians
    assert len(g) == 2 * N + 5 and g.dynamic.sum() == 2 * N and g.color.shape == (29, 4, 3)
    for k in (1, 2):
        state = g.state_at(0.02 * k)
        both = np.concatenate([place(0.02 * k), place(0.02 * k) + [10, 0, 0]])
        np.testing.assert_allclose(state.position[: 2 * N], both, atol=1e-6)
        np.testing.assert_allclose(state.velocity[: 2 * N], np.tile(velocity(0.02 * k), (2, 1)), atol=1e-4)
        np.testing.assert_allclose(state.opacity[-2:], 0.0 if k == 2 else 0.5)
    np.testing.assert_allclose(g.color[:N, 0], 0, atol=1e-6)
    np.testing.assert_allclose(0.5 + C0 * g.color[24:27, 0], 0.5 + C0 * 0.1, atol=1e-6)
    said = " ".join(imported.notes)
    assert "/low: of purpose proxy" in said and "/wall, /blinks: stands still, taken as background" in said


def test_times_of_two_attributes_that_differ_by_rounding_are_one(tmp_path):
    stages.openusd()
    place, velocity = ways()
    stage = stages.new(tmp_path / "a.usda")
    samples = {k: {"positions": place(0.02 * k), "scales": np.full((N, 3), 0.1)} for k in range(5)}
    samples |= {k + 1e-6: {"opacities": np.full(N, 0.5)} for k in range(5)}
    stages.splats(stage, "/a", samples)
    stage.Save()
    g = read_result(tmp_path / "a.usda").gaussians
    assert len(g.time_s) == 5
    np.testing.assert_allclose(g.state_at(0.04).velocity, velocity(0.04), atol=1e-4)


# ---------------------------------------------------------------- refused


def changed(**changes):
    """Samples at five time codes, of which the one at code 2 has these changes; None leaves an attribute out."""
    place = ways()[0]
    samples = {k: {"positions": place(0.02 * k), **plain()} for k in range(5)}
    for name, value in changes.items():
        for k in samples:
            if value is None:
                del samples[k][name]
        if value is not None:
            samples[2][name] = value
    return samples


def spoilt(width, row=3, value=np.nan, fill=0.5):
    values = np.full((N, width) if width > 1 else N, fill)
    values[row] = value
    return values


REFUSED = {
    "still": ({}, r"/fire: stands still.*time samples"),
    "no places": (changed(positions=None), "/fire: has no 'positions'"),
    "no sizes": (changed(scales=None), "/fire: has no 'scales' at time code 0"),
    "NaN": (changed(positions=spoilt(3)), r"/fire: 'positions' at time code 2 holds NaN or Inf \(rows \[3\]\)"),
    "too few": (changed(opacities=np.ones(5)), "/fire: 'opacities' at time code 2 has 5 entries for 12 Gaussians"),
    "too many": (changed(scales=np.ones((13, 3))), "/fire: 'scales' at time code 2 has 13 entries for 12"),
    "logits": (changed(opacities=spoilt(1, value=-3.0)), r"/fire: 'opacities' at time code 2 must be within 0..1"),
    "logarithms": (changed(scales=spoilt(3, value=-4.0)), r"'scales' at time code 2 must be > 0 \(not their log"),
    "no turn": (changed(orientations=spoilt(4, value=0.0)), "'orientations' at time code 0 must be quaternions other"),
    "harmonics": (changed(sh=np.ones((N, 3))), "at time code 0 has 12 entries; 12 Gaussians of.* 3 have 192"),
    "colours": (changed(**{"primvars:displayColor": np.ones((5, 3))}), "displayColor' at time code 0 has 5 entries"),
    "one id": (changed() and {k: v | {"primvars:id": np.zeros(N)} for k, v in changed().items()}, "an id occurs twice"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(tmp_path, kind):
    stages.openusd()
    samples, said = REFUSED[kind]
    stage = stages.new(tmp_path / "bad.usda")
    stages.splats(stage, "/fire", samples, **({} if samples else {"positions": np.zeros((N, 3)), **plain()}))
    stage.Save()
    with pytest.raises(DataFormatError, match=said) as error:
        read_result(tmp_path / "bad.usda")
    assert "bad.usda" in str(error.value)


def test_stages_that_cannot_be_read_are_refused(tmp_path):
    stages.openusd()
    from pxr import Sdf, UsdGeom

    def refused(said, change):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.usda"
        stage = stages.new(path)
        change(stage)
        stage.Save()
        with pytest.raises(DataFormatError, match=said) as error:
            read_result(path)
        assert path.name in str(error.value)

    def fire(stage, path="/fire"):
        return stages.splats(stage, path, changed())

    def stretched(stage):
        UsdGeom.Xformable(fire(stage)).AddScaleOp().Set((1, 2, 1))

    def scattered(stage):
        UsdGeom.PointInstancer.Define(stage, "/many").GetPrototypesRel().AddTarget("/many/fire")
        fire(stage, "/many/fire")

    def typed(stage):
        fire(stage).CreateAttribute("velocities", Sdf.ValueTypeNames.StringArray).Set(["fast"])

    def flat(stage):
        stage.DefinePrim("/flat", "ParticleField")

    def metres(stage):
        fire(stage)
        UsdGeom.SetStageMetersPerUnit(stage, -1.0)

    refused("/fire: its transform at time code 0 stretches.*apply it", stretched)
    refused("/many: scatters splats", scattered)
    refused(r"/fire: 'velocities' at time code 0 is of type string\[\]", typed)
    refused(r"holds no ParticleField3DGaussianSplat.*other shapes.*\(1\); give", flat)
    refused(r"but Points \(1\)", lambda stage: UsdGeom.Points.Define(stage, "/p"))
    refused("metersPerUnit", metres)
    refused("timeCodesPerSecond", lambda stage: fire(stage) and stage.SetTimeCodesPerSecond(-1))
    refused(
        "Could not open asset @gone.usda@.*; put what it refers to beside it",
        lambda stage: UsdGeom.Xform.Define(stage, "/a").GetPrim().GetReferences().AddReference("gone.usda"),
    )


def damaged(whole, number):
    """A copy of a file that is damaged in one of six ways."""
    data, rng = bytearray(whole), np.random.default_rng(number)
    small = [at for at in range(88, len(data) - 8) if 0 < int.from_bytes(data[at : at + 8], "little") < 5000]
    match number % 6:
        case 0:
            for at in rng.integers(0, len(data), rng.integers(1, 4)):
                data[at] = rng.integers(256)
        case 1:
            at = 8 * rng.integers(1, len(data) // 8)
            data[at : at + 8] = rng.bytes(8)
        case 2:
            del data[rng.integers(8, len(data)) :]
        case 3:
            at = rng.integers(8, len(data) - 64)
            data[at : at + rng.integers(1, 64)] = bytes(rng.integers(1, 64))
        case 4:  # where the structure is
            for at in rng.integers(len(data) - 1500, len(data), rng.integers(1, 6)):
                data[at] = rng.integers(256)
        case _ if small:  # counts, which become millions
            for at in rng.choice(small, 2):
                data[at + 3] = rng.integers(1, 30)
    return bytes(data)


READS = """
import json, sys
from gof.core.costs import peak_memory_mb
from gof.core.errors import DataFormatError
from gof.io.importers import read_result
ends = []
for path in sys.argv[1:]:
    try:
        read_result(path)
        ends.append("read")
    except DataFormatError as e:
        ends.append(str(e))
print(json.dumps([ends, peak_memory_mb()]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is counted in other units elsewhere")
def test_a_damaged_binary_file_costs_no_memory(tmp_path):
    """OpenUSD alone takes up to 13 GB for such copies of a file of 10 kB."""
    stages.openusd()
    whole = written(tmp_path, moving(60), "good.usdc")[1].read_bytes()
    paths = [tmp_path / f"bad{number}.usdc" for number in range(200)]
    for number, path in enumerate(paths):
        path.write_bytes(damaged(whole, number))
    done = subprocess.run([sys.executable, "-c", READS, *map(str, paths)], capture_output=True, text=True, check=True)
    ends, peak_mb = json.loads(done.stdout)
    assert peak_mb < 1000, "some 400 of them for modules"
    said = {path: end for path, end in zip(paths, ends, strict=True) if end != "read"}
    assert len(said) > 100 and all(path.name in end for path, end in said.items())
    assert sum("entries where there are bytes for" in end for end in said.values()) > 20


def test_every_count_of_a_binary_file_is_held_against_its_bytes(tmp_path):
    """Each number of the structure that OpenUSD takes memory for, and of arrays in values, samples and dictionaries."""
    stages.openusd()
    stage = stages.new(tmp_path / "a.usdc")
    stages.splats(stage, "/fire", changed())
    stage.SetMetadata("customLayerData", {"a": {"numbers": [0.25 * k for k in range(40)]}})
    stage.Save()
    whole = (tmp_path / "a.usdc").read_bytes()
    usd_crate.check(tmp_path / "a.usdc")
    contents = int.from_bytes(whole[16:24], "little")
    rows = [whole[at : at + 32] for at in range(contents + 8, contents + 8 + 6 * 32, 32)]
    begin = {row[:16].rstrip(b"\0").decode(): int.from_bytes(row[16:24], "little") for row in rows}
    assert list(begin) == ["TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS"]
    places = {f"its section {name}": at for name, at in begin.items()} | {"its table of contents": contents}
    numbers = whole.index(np.float64(0.25).tobytes() + np.float64(0.5).tobytes()) - 8 - 8
    positions = whole.index(np.float32(changed()[0]["positions"]).tobytes()) - 8
    assert (whole[numbers], whole[positions]) == (40, N)
    places |= {f"an array at byte {at:,}": at for at in (numbers, positions)}
    for what, at in places.items():
        for data in (whole, b"PK\3\4" + bytes(60) + whole):  # and as a package has it
            path, offset = tmp_path / ("b.usdc" if data is whole else "b.usdz"), len(data) - len(whole)
            path.write_bytes(data[: at + offset + 3] + b"\1" + data[at + offset + 4 :])
            with pytest.raises(DataFormatError, match=f"is damaged: {what}.*announces 1.,...,... entries"):
                usd_crate.check(path)
    (tmp_path / "old.usdc").write_bytes(whole[:9] + b"\4" + whole[10:])
    with pytest.raises(DataFormatError, match="version 0.4, from before 2018.*usdcat"):
        read_result(tmp_path / "old.usdc")


def test_a_damaged_file_that_a_good_one_refers_to_is_named(tmp_path):
    """By reference, payload, sublayer and clip, from a file that itself is referred to, in a circle."""
    stages.openusd()
    stage = stages.new(tmp_path / "flame.usdc")
    stages.splats(stage, "/fire", changed())
    stage.SetMetadata("customLayerData", {"a": {"numbers": [0.25 * k for k in range(40)]}})
    stage.Save()
    good = (tmp_path / "flame.usdc").read_bytes()
    at = good.index(np.float32(changed()[0]["positions"]).tobytes()) - 8
    clips = "asset[] assetPaths = [@flame.usdc@]\ndouble2[] active = [(0, 0)]\ndouble2[] times = [(0, 0)]"
    again = 'def "b" (references = @scene.usda@</b>)\n{\n}\n'  # goes in a circle
    texts = {
        "reference": f'def "fire" (references = @flame.usdc@</fire>)\n{{\n}}\n{again}',
        "payload": 'def "fire" (payload = @./flame.usdc@</fire>)\n{\n}\n',
        "clip": f'def "fire" (clips = {{dictionary default = {{{clips}\nstring primPath = "/fire"}}}})\n{{\n}}\n',
        "sublayer": "(subLayers = [@flame.usdc@])\n",
    }
    for kind, text in texts.items():
        (tmp_path / f"{kind}.usda").write_text(f"#usda 1.0\n{text}")
        scene = f'#usda 1.0\ndef "fire" (references = @{kind}.usda@</fire>)\n{{\n}}\ndef "b"\n{{\n}}\n'
        (tmp_path / "scene.usda").write_text(scene)
        (tmp_path / "flame.usdc").write_bytes(good)
        if kind != "clip":  # which has the times alone, not the splats
            read_result(tmp_path / "scene.usda")
        (tmp_path / "flame.usdc").write_bytes(good[: at + 3] + b"\1" + good[at + 4 :])
        with pytest.raises(DataFormatError, match=r"scene.usda: refers to .*flame.usdc, which is damaged: .* entries"):
            read_result(tmp_path / "scene.usda")


def test_damage_is_an_error_or_a_result_and_no_fault(tmp_path):
    stages.openusd()
    stage = stages.new(tmp_path / "a.usda")
    stages.splats(stage, "/fire", changed())
    stage.Save()
    rng, whole, refused = np.random.default_rng(0), (tmp_path / "a.usda").read_bytes(), 0
    for number in range(150):
        data, path = bytearray(whole), tmp_path / f"bad{number}.usda"
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            read_result(path)
        except GofError as e:
            refused += 1
            assert path.name in str(e)
    assert refused > 40
    for name, data in (
        ("a.usda", b"#usda 1.0\ndef Xform {"),
        ("b.usd", b"no"),
        ("c.usdz", whole),
        ("d.usdc", b"PXR-USDC"),
        ("e.usdc", b""),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(DataFormatError, match="is damaged|OpenUSD cannot read it") as error:
            read_result(tmp_path / name)
        assert name in str(error.value)


def test_openusds_warnings_are_not_printed(tmp_path, capfd):
    stages.openusd()
    from pxr import Tf

    if not hasattr(Tf, "DiagnosticTrap"):
        pytest.skip("this OpenUSD cannot be kept from printing its warnings")
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef Xform "a" (references = @gone.usda@)\n{\n}\n')
    with pytest.raises(DataFormatError):
        read_result(tmp_path / "a.usda")
    assert "Warning" not in capfd.readouterr().err


def test_without_openusd_the_error_says_what_to_install(tmp_path, monkeypatch):
    usd.save(moving(), tmp_path / "a.usda", START_S, END_S, STEP_S)
    monkeypatch.setitem(sys.modules, "pxr", None)
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    with pytest.raises(MissingDependencyError, match=r"a\.usda: reading OpenUSD needs pxr: pip install .*\[usd\]"):
        read_result(tmp_path / "a.usda")
    with pytest.raises(MissingDependencyError, match=r"b\.usdc: writing .*\[usd\]"):
        usd.save(moving(), tmp_path / "b.usdc", START_S, END_S, STEP_S)
    assert not list(tmp_path.glob("b*"))
    older = types.ModuleType("pxr.Usd")
    older.GetVersion = lambda: (0, 25, 2)
    monkeypatch.setitem(sys.modules, "pxr.Usd", older)
    with pytest.raises(MissingDependencyError, match=r"26\.3 or later.*here is 25\.2, as a Blender brings it.*\[usd\]"):
        read_result(tmp_path / "a.usda")
