"""TransientGaussians and its two files: closed form, round trip, and every way a file can be wrong."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError, NonFiniteError
from gof.core.gaussians import TransientGaussians
from tests.conftest import random_gaussians
from tests.plys import read_ply

FIELDS = ("position", "velocity", "t_mu", "t_sigma", "scale", "rotation", "opacity", "color", "dynamic")


def test_state_follows_the_closed_form(gaussians):
    for t in (-0.3, 0.0, 0.77):
        position, opacity = gaussians.at(t)
        for i in range(len(gaussians)):
            dt = t - float(gaussians.t_mu[i])
            if gaussians.dynamic[i]:
                np.testing.assert_allclose(position[i], gaussians.position[i] + dt * gaussians.velocity[i], atol=1e-6)
                window = np.exp(-0.5 * (dt / float(gaussians.t_sigma[i])) ** 2)
                np.testing.assert_allclose(opacity[i], gaussians.opacity[i] * window, atol=1e-6)
            else:
                np.testing.assert_array_equal(position[i], gaussians.position[i])
                assert opacity[i] == gaussians.opacity[i]


def test_window_is_finite_far_away_and_for_tiny_lifetimes():
    g = random_gaussians(4)
    g.t_sigma[:] = 1e-30
    position, opacity = g.at(1e6)
    assert np.isfinite(position).all() and np.isfinite(opacity).all()
    assert (opacity[g.dynamic] == 0).all()


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
@pytest.mark.parametrize("sh", [0, 4, 16])
@pytest.mark.parametrize("n", [0, 1, 40])
def test_round_trip(tmp_path, suffix, sh, n):
    g = random_gaussians(n, sh_coefficients=sh)
    loaded = TransientGaussians.load(g.save(tmp_path / f"g{suffix}"))
    for name in FIELDS:
        a, b = getattr(g, name), getattr(loaded, name)
        assert a.shape == b.shape and a.dtype == b.dtype
        np.testing.assert_allclose(b, a, rtol=1e-6, atol=2e-7, err_msg=name)
    assert [p.name for p in tmp_path.iterdir()] == [f"g{suffix}"], "no temporary file stays behind"


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_gas_has_a_velocity_of_its_own_where_somebody_knows_it(tmp_path, suffix):
    together = random_gaussians(20)
    assert TransientGaussians.load(together.save(tmp_path / f"one{suffix}")).gas_velocity is None
    expected = np.where(together.dynamic[:, None], together.velocity, 0)
    np.testing.assert_array_equal(together.moving_gas, expected)
    gas = np.random.default_rng(1).normal(size=(20, 3)).astype(np.float32)
    apart = replace(together, gas_velocity=gas)
    loaded = TransientGaussians.load(apart.save(tmp_path / f"two{suffix}"))
    np.testing.assert_array_equal(loaded.gas_velocity, gas)
    np.testing.assert_array_equal(loaded.moving_gas, np.where(apart.dynamic[:, None], gas, 0))
    np.testing.assert_array_equal(loaded.at(0.3)[0], together.at(0.3)[0], "light moves the Gaussian, not gas")


def test_gas_turns_with_the_world_and_joins_what_knows_of_none():
    apart = replace(random_gaussians(6), gas_velocity=np.tile([0, 0, 3.0], (6, 1)))
    lying = 2 * np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 0.5]])  # z to -y, twice as large
    np.testing.assert_allclose(apart.transformed(lying).gas_velocity, np.tile([0, -6.0, 0], (6, 1)))
    joined = TransientGaussians.concatenate([random_gaussians(4), apart, random_gaussians(3)])
    np.testing.assert_array_equal(joined.gas_velocity[:4], random_gaussians(4).moving_gas)
    assert len(joined.gas_velocity) == 13 and (joined[4:10].gas_velocity[:, 2] == np.where(apart.dynamic, 3, 0)).all()
    with pytest.raises(DataFormatError, match="'gas_velocity' has shape"):
        replace(apart, gas_velocity=np.zeros((5, 3)))
    with pytest.raises(NonFiniteError, match="'gas_velocity'"):
        replace(apart, gas_velocity=np.full((6, 3), np.nan))


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
@pytest.mark.parametrize("datum", [None, Datum((1.0, 2.0, 3.0), 4.0)])
def test_emissive_stays_so_in_files_parts_and_other_worlds(tmp_path, suffix, datum):
    flame = replace(random_gaussians(6), emissive=True, datum=datum)
    loaded = TransientGaussians.load(flame.save(tmp_path / f"flame{suffix}"))
    assert loaded.emissive and loaded.datum == datum
    assert not TransientGaussians.load(random_gaussians(6).save(tmp_path / f"other{suffix}")).emissive
    assert flame[:3].emissive and flame.transformed(np.eye(4)).emissive and flame.state_at(0.0).emissive
    assert TransientGaussians.concatenate([flame, flame]).emissive
    assert not TransientGaussians.concatenate([flame, random_gaussians(2)]).emissive


def test_emissive_is_one_bool(tmp_path):
    path = replace(random_gaussians(3), emissive=True).save(tmp_path / "g.npz")
    content = dict(np.load(path))
    for wrong in (np.ones(3, bool), np.array(1)):
        np.savez(path, **content | {"emissive": wrong})
        with pytest.raises(DataFormatError, match="'emissive'"):
            TransientGaussians.load(path)


def test_ply_opens_in_an_independent_reader_with_the_3dgs_conventions(tmp_path):
    g = random_gaussians(7)
    v, comments = read_ply(g.save(tmp_path / "g.ply"))
    np.testing.assert_allclose(np.exp(v["scale_1"]), g.scale[:, 1], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-v["opacity"].astype(float))), g.opacity, atol=1e-6)
    np.testing.assert_allclose(v["rot_0"], g.rotation[:, 0])
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * v["f_dc_2"], g.color[:, 2], atol=1e-6)
    np.testing.assert_allclose(v["vz"], g.velocity[:, 2])
    assert any("m/s" in c for c in comments)


def test_opacity_zero_and_one_survive_the_logit(tmp_path):
    g = random_gaussians(2)
    g.opacity[:] = [0, 1]
    loaded = TransientGaussians.load(g.save(tmp_path / "g.ply"))
    np.testing.assert_allclose(loaded.opacity, [0, 1], atol=1e-7)


@pytest.mark.parametrize("name", [f for f in FIELDS if f != "dynamic"])
def test_nan_is_named(name):
    values = {f: getattr(random_gaussians(5), f) for f in FIELDS}
    values[name] = values[name].copy()
    values[name][3] = np.nan
    with pytest.raises(NonFiniteError, match=rf"'{name}'.*\[3\]"):
        TransientGaussians(**values)


@pytest.mark.parametrize(
    "name, value, rule",
    [("scale", -1.0, "linear"), ("opacity", 2.0, "logit"), ("t_sigma", 0.0, "> 0"), ("rotation", 0.0, "non-zero")],
)
def test_values_out_of_range_are_named(name, value, rule):
    values = {f: getattr(random_gaussians(5), f).copy() for f in FIELDS}
    values[name][2] = value
    with pytest.raises(DataFormatError, match=rf"'{name}' must be .*{rule}.*\[2\]"):
        TransientGaussians(**values)


def test_shapes_must_agree():
    values = {f: getattr(random_gaussians(5), f) for f in FIELDS}
    with pytest.raises(DataFormatError, match="'t_mu' has shape"):
        TransientGaussians(**values | {"t_mu": np.zeros(4)})
    with pytest.raises(DataFormatError, match="has shape"):
        TransientGaussians(**values | {"position": np.array(1.0)})
    with pytest.raises(DataFormatError, match="'color' has shape"):
        TransientGaussians(**values | {"color": np.zeros((5, 5, 3))})


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
@pytest.mark.parametrize("keep", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(tmp_path, suffix, keep):
    path = random_gaussians(40).save(tmp_path / f"g{suffix}")
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(DataFormatError, match=f"g{suffix}"):
        TransientGaussians.load(path)


def test_missing_fields_and_wrong_versions_are_named(tmp_path):
    g = random_gaussians(3)
    path = g.save(tmp_path / "g.npz")
    content = dict(np.load(path))
    np.savez(path, **{k: v for k, v in content.items() if k != "t_mu_s"})
    with pytest.raises(DataFormatError, match="t_mu_s"):
        TransientGaussians.load(path)
    np.savez(path, **content | {"schema": np.array("gof-linear/9")})
    with pytest.raises(DataFormatError, match="gof-linear/9"):
        TransientGaussians.load(path)
    ply = g.save(tmp_path / "g.ply")
    ply.write_bytes(ply.read_bytes().replace(b"gof-transient 1", b"gof-transient 7"))
    with pytest.raises(DataFormatError, match="gof-transient 7"):
        TransientGaussians.load(ply)
    ply = g.save(tmp_path / "h.ply")
    ply.write_bytes(ply.read_bytes().replace(b"property float t_mu", b"property float t_mi"))
    with pytest.raises(DataFormatError, match="t_mu"):
        TransientGaussians.load(ply)


def test_absurd_header_allocates_nothing(tmp_path):
    path = random_gaussians(3).save(tmp_path / "g.ply")
    path.write_bytes(path.read_bytes().replace(b"element vertex 3", b"element vertex 1000000000000000000"))
    with pytest.raises(DataFormatError, match="1000000000000000000 points"):
        TransientGaussians.load(path)


def test_a_pickle_is_never_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    content = {"schema": np.array("gof-linear/1"), "x0": np.array([Evil()], dtype=object)}
    np.savez(tmp_path / "evil.npz", **content)
    with pytest.raises(GofError):
        TransientGaussians.load(tmp_path / "evil.npz")
    assert not (tmp_path / "ran").exists()


def test_unknown_suffix_and_absent_file(tmp_path, gaussians):
    with pytest.raises(DataFormatError, match="suffix"):
        gaussians.save(tmp_path / "g.obj")
    with pytest.raises(DataFormatError, match="no such file"):
        TransientGaussians.load(tmp_path / "absent.ply")


def test_the_dead_do_not_weigh_in_a_ply(tmp_path):
    """DVE weighs by opacity times volume, which of a large Gaussian makes up for six zeros."""
    g = random_gaussians(4)
    g = replace(g, opacity=np.array([0.0, 1e-12, 0.5, 1.0]))
    g.save(tmp_path / "a.ply")
    back = TransientGaussians.load(tmp_path / "a.ply").opacity
    assert back[0] < 1e-30 and back[1] == pytest.approx(1e-12, rel=1e-4) and back[2] == pytest.approx(0.5)
