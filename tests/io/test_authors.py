"""The released code of the paper: checkpoints, PLYs and the bounds of sizes, against the scenes that were written."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gof.core.errors import DataFormatError  # noqa: E402
from gof.io.importers import ImportOptions, read_result  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.lookalikes import logistic  # noqa: E402


def test_authors_checkpoint(tmp_path):
    path, raw = lookalikes.authors(tmp_path / "model")
    got = read_result(path)
    g, d = got.gaussians, raw["dynamic"]
    assert got.method == "authors" and len(g) == 30 and (g.dynamic == d).all()
    np.testing.assert_allclose(g.velocity, raw["velocity"] * 1000, rtol=1e-6)  # per millisecond -> per second
    np.testing.assert_allclose(g.t_mu, raw["t_mu"][:, 0] / 1000, rtol=1e-6)
    np.testing.assert_allclose(g.scale[d], 0.001 + 0.029 * logistic(raw["scaling"][d]), rtol=1e-5)
    np.testing.assert_allclose(g.scale[~d], np.exp(raw["scaling"][~d]), rtol=1e-5)
    for t_ms in (0.0, 33.0, 80.0):  # position and opacity of its renderer, in its units
        dt = t_ms - raw["t_mu"]
        position, opacity = g.at(t_ms / 1000)
        np.testing.assert_allclose(position[d], (raw["xyz"] + dt * raw["velocity"])[d], atol=1e-5)
        np.testing.assert_allclose(
            opacity[d], (logistic(raw["opacity"]) * np.exp(-(dt**2) / (2 * raw["t_sigma"] ** 2)))[d, 0], atol=1e-5
        )
    assert read_result(tmp_path / "model").path == path  # the folder finds its newest checkpoint


def test_authors_without_bounds_or_with_wrong_ones(tmp_path):
    path, _ = lookalikes.authors(tmp_path / "model")
    bounds = tmp_path / "model/point_cloud/iteration_7000/scale_bounds.json"
    bounds.write_text(json.dumps({"dynamic_scale_min": 0.1}))
    with pytest.raises(DataFormatError, match="dynamic_scale_max"):
        read_result(path)
    bounds.unlink()
    with pytest.raises(DataFormatError, match=r"scale_bounds\.json is missing"):
        read_result(path)


@pytest.mark.parametrize("write", [lookalikes.released_ply, lookalikes.released_checkpoint])
def test_authors_release_gives_back_the_scene_it_holds(tmp_path, write):
    scene = lookalikes.released_scene()
    path = write(tmp_path / "model", scene)
    got = read_result(path)
    g, moves = got.gaussians, scene["dynamic"]
    assert got.method == "authors" and any("scale bounds" in n for n in got.notes)
    np.testing.assert_array_equal(g.dynamic, moves)
    np.testing.assert_allclose(g.velocity[moves], scene["velocity"][moves], rtol=1e-5)
    for name in ("position", "scale", "opacity", "color"):
        np.testing.assert_allclose(getattr(g, name), scene[name], rtol=2e-4, atol=1e-6, err_msg=name)
    for name in ("t_mu", "t_sigma"):
        np.testing.assert_allclose(getattr(g, name), scene[name], rtol=1e-5, err_msg=name)
    np.testing.assert_allclose(np.abs((g.rotation * scene["rotation"]).sum(1)), 1, atol=1e-5)
    still = g.at(5.0)[0][~moves]  # long after: the background stays, whatever its velocity column says
    np.testing.assert_allclose(still, scene["position"][~moves], atol=1e-6)
    assert read_result(tmp_path / "model").path == path  # the folder finds it
    shifted = read_result(path, ImportOptions(time_zero_s=-0.01)).gaussians
    np.testing.assert_allclose(shifted.t_mu, scene["t_mu"] - 0.01, atol=1e-6)


def test_authors_release_with_its_bounds_lost_or_absent(tmp_path):
    scene = lookalikes.released_scene()
    path = lookalikes.released_ply(tmp_path / "model", scene)
    (path.parent / "point_cloud_scale_bounds.json").unlink()
    with pytest.raises(DataFormatError, match=r"point_cloud_scale_bounds\.json is missing"):
        read_result(path)
    for bounds, said in (((0.3, 0.1), "not 0 < min < max"), ((0.1, None), "needs numbers")):
        with pytest.raises(DataFormatError, match=said):
            read_result(lookalikes.released_checkpoint(tmp_path / said, scene, bounds=bounds))
    without = read_result(lookalikes.released_checkpoint(tmp_path / "none", scene, bounds=(None, None)))
    raw = lookalikes.released_raw(scene)["scaling"]  # its code then takes all sizes as logarithms
    np.testing.assert_allclose(without.gaussians.scale, np.exp(raw), rtol=1e-4)


def test_authors_ply_has_no_velocity(tmp_path):
    raw = {k: v.detach().numpy() for k, v in lookalikes.capture(np.random.default_rng(0), 4).items()}
    lookalikes.splat_ply(tmp_path / "point_cloud.ply", raw, {k: np.ones(4) for k in ("t_mu", "t_sigma", "is_dynamic")})
    with pytest.raises(DataFormatError, match="no velocities"):
        read_result(tmp_path / "point_cloud.ply")
