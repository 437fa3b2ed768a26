"""FreeTimeGS: checkpoints, npz and .ftgs.ply, against the motions that were written."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gof.core.errors import DataFormatError  # noqa: E402
from gof.core.ftgs import save as save_ftgs  # noqa: E402
from gof.io.importers import ImportOptions, read_result  # noqa: E402
from tests.conftest import random_gaussians  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.lookalikes import logistic  # noqa: E402


def test_freetime_checkpoint_and_canonical_npz(tmp_path):
    raw = lookalikes.freetime(tmp_path / "results/ckpts/ckpt_29999.pt")
    np.savez(tmp_path / "canonical_4d.npz", **raw, n_frames=61, start_frame=0, end_frame=61, use_velocity=True)
    options = ImportOptions(frame_time_s=0.02)  # 61 frames: the sequence lasts 1.2 s
    for path in (tmp_path / "results", tmp_path / "canonical_4d.npz"):
        got = read_result(path, options)
        g = got.gaussians
        assert got.method == "freetime" and any("normalises" in n for n in got.notes)
        for tau in (0.0, 0.25, 0.9):
            dt = tau - raw["times"]
            position, opacity = g.at(1.2 * tau)
            np.testing.assert_allclose(position, raw["means"] + dt * raw["velocities"], atol=1e-5)
            window = np.exp(-0.5 * (dt[:, 0] / np.maximum(np.exp(raw["durations"][:, 0].astype(float)), 0.02)) ** 2)
            np.testing.assert_allclose(opacity, logistic(raw["opacities"]) * window, atol=2e-5)
    with pytest.raises(DataFormatError, match="--time-unit"):
        read_result(tmp_path / "canonical_4d.npz")


def test_freetime_variants_are_refused(tmp_path):
    lookalikes.freetime(tmp_path / "a.pt", drop=("velocities",))
    with pytest.raises(DataFormatError, match="nine of FreeTimeGS"):
        read_result(tmp_path / "a.pt")


def test_ftgs_ply_there_and_back(tmp_path):
    for sh in (0, 4, 16):
        g = random_gaussians(25, sh_coefficients=sh)
        g.t_sigma[np.flatnonzero(g.dynamic)[:3]] = 0.03  # too short for it
        path = save_ftgs(g, tmp_path / f"{sh}.ftgs.ply", start_s=-0.5, end_s=1.5, frames=51)
        back = read_result(path, ImportOptions(frame_time_s=0.04, time_zero_s=-0.5)).gaussians
        shortest = 0.02 * 2.0  # s: its renderer never uses less than 2 % of the sequence
        for t in (0.0, 0.3, 1.0):
            dt = np.where(g.dynamic, t - g.t_mu.astype(float), 0.0)
            position, opacity = back.at(t)
            np.testing.assert_allclose(position, g.position + dt[:, None] * g.velocity, atol=2e-5)
            window = np.exp(-0.5 * (dt / np.maximum(g.t_sigma, shortest)) ** 2)
            np.testing.assert_allclose(opacity, g.opacity * window, atol=2e-5)
        np.testing.assert_allclose(back.velocity, np.where(g.dynamic[:, None], g.velocity, 0), atol=1e-5)
        np.testing.assert_allclose(back.scale, g.scale, rtol=1e-4)
    header = (tmp_path / "0.ftgs.ply").read_bytes().split(b"end_header")[0].decode()
    assert (
        "comment ftgs_version 1\ncomment time_units normalized\ncomment sh_degree 0\ncomment use_velocity 1" in header
    )
    assert "property float velocity_2" in header and "format binary_little_endian 1.0" in header


def test_ftgs_ply_of_another_version(tmp_path):
    path = save_ftgs(random_gaussians(3), tmp_path / "a.ftgs.ply", 0, 1, 10)
    path.write_bytes(path.read_bytes().replace(b"ftgs_version 1", b"ftgs_version 2"))
    with pytest.raises(DataFormatError, match="ftgs_version 2"):
        read_result(path)


@pytest.mark.parametrize(
    "said",
    [
        {"time_units": "seconds"},
        {"model_spec": {"time_units": "frames"}},
        {"model_spec": {"duration_activation": "sigmoid"}},
        {"use_marginal_gating": True},
        {"use_color_velocity": True},
        {"color_correction": {"a": torch.ones(3)}},
        {"model_spec": [1]},
        {"n_frames": "61"},
    ],
    ids=str,
)
def test_variants_of_freetime_are_refused(tmp_path, said):
    """What the method's own validate_vanilla_checkpoint refuses is refused here."""
    lookalikes.freetime(tmp_path / "ckpt_1.pt", extra=said)
    with pytest.raises(DataFormatError, match="ckpt_1.pt"):
        read_result(tmp_path / "ckpt_1.pt", ImportOptions(time_unit_s=2.0))
    plain = {"time_units": "normalized", "color_correction": None, "use_marginal_gating": False}
    lookalikes.freetime(tmp_path / "ckpt_2.pt", extra=plain | {"model_spec": {"min_duration": 0.001}})
    short = read_result(tmp_path / "ckpt_2.pt", ImportOptions(time_unit_s=2.0)).gaussians.t_sigma
    assert 0.002 <= short.min() < 0.02 * 2


def test_an_ftgs_ply_of_ours_comes_back_without_options(tmp_path):
    """Which seconds its times 0 and 1 are, and what it cannot hold, is said and written."""
    from gof.io.convert import convert
    from gof.io.importers import Imported

    g = replace(random_gaussians(30), t_sigma=np.full(30, 0.005))
    said = convert(Imported(g, "gof", tmp_path / "a.npz"), tmp_path / "a.ftgs.ply", 0.1, 0.45)
    assert "0.1..0.45 s" in said[0] and "shorter than the format's least" in said[1]
    back = read_result(tmp_path / "a.ftgs.ply").gaussians
    np.testing.assert_allclose(back.t_mu[g.dynamic], g.t_mu[g.dynamic], atol=1e-6)
    np.testing.assert_allclose(back.velocity[g.dynamic], g.velocity[g.dynamic], rtol=1e-5)


def test_background_stays_background(tmp_path):
    """What neither moves nor fades is none of the motion that DVE asks for; what is always on is not finite."""
    g = random_gaussians(60)
    lives = np.where(np.arange(60) % 3, g.t_sigma, np.inf)
    g = replace(g, dynamic=np.arange(60) % 2 == 0, t_sigma=lives)
    save_ftgs(g, tmp_path / "a.ftgs.ply", 0.0, 1.0)
    back = read_result(tmp_path / "a.ftgs.ply").gaussians
    np.testing.assert_array_equal(back.dynamic, g.dynamic)
    np.testing.assert_array_equal(np.isinf(back.t_sigma), np.isinf(g.t_sigma) | ~g.dynamic)
