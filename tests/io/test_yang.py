"""4DGS of Yang et al. against the density in space and time that its checkpoint means."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch")

from gof.commands.cli import main  # noqa: E402
from gof.core.errors import DataFormatError  # noqa: E402
from gof.io.importers import ImportOptions, read_result  # noqa: E402
from tests.io import lookalikes  # noqa: E402
from tests.io.lookalikes import logistic, yang_covariance  # noqa: E402


def test_yang_against_the_density_in_space_time(tmp_path):
    """Velocity by finite differences of the most likely place at each time; shape and window from the 4D density."""
    raw = lookalikes.yang(tmp_path / "chkpnt30000.pth")
    got = read_result(tmp_path / "chkpnt30000.pth")
    g, S = got.gaussians, yang_covariance(raw)
    assert got.method == "yang" and any("colours" in n for n in got.notes)
    for i in range(len(g)):
        precision = np.linalg.inv(S[i])

        def likeliest(t, precision=precision, i=i):  # the maximum over x of the density at time t
            return raw["xyz"][i] - np.linalg.solve(precision[:3, :3], precision[:3, 3]) * (t - raw["t"][i, 0])

        difference = (likeliest(0.7 + 1e-3) - likeliest(0.7 - 1e-3)) / 2e-3
        np.testing.assert_allclose(g.velocity[i], difference, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(g[i : i + 1].at(0.7)[0][0], likeliest(0.7), atol=1e-4)
        R = Rotation.from_quat(g.rotation[i, [1, 2, 3, 0]]).as_matrix()
        conditional = R @ np.diag(g.scale[i].astype(float) ** 2) @ R.T
        np.testing.assert_allclose(
            conditional, np.linalg.inv(precision[:3, :3]), rtol=1e-3, atol=1e-3 * np.trace(conditional)
        )
        # integrating the density over space leaves exp(-dt^2 / (2 S_tt))
        ratio = g[i : i + 1].at(0.4)[1][0] / logistic(raw["opacity"][i, 0])
        assert ratio == pytest.approx(np.exp(-((0.4 - raw["t"][i, 0]) ** 2) / (2 * S[i][3, 3])), rel=1e-3, abs=1e-6)
    det = np.exp(raw["scaling"].astype(float).sum(1) + raw["scaling_t"][:, 0]) / np.sqrt(S[:, 3, 3])
    np.testing.assert_allclose(g.scale.astype(float).prod(1), det, rtol=1e-4)  # the DVE weight's volume


def test_yang_before_and_since_september_2024(tmp_path):
    """One file, two meanings: its commit 900c592 reversed the order of the axes that the quaternions turn."""
    raw = lookalikes.yang(tmp_path / "chkpnt30000.pth")
    for date, flip in (("2024-09-14", False), ("2024-09-15", True), (None, True)):
        S = yang_covariance(raw, flip)
        got = read_result(tmp_path / "chkpnt30000.pth", ImportOptions(code_date=date))
        np.testing.assert_allclose(got.gaussians.velocity, S[:, :3, 3] / S[:, 3, 3, None], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(got.gaussians.t_sigma, np.sqrt(S[:, 3, 3]), rtol=1e-5)
        assert any("code_date" in note for note in got.notes) == (date is None)


def test_the_date_of_its_code_stands_beside_the_checkpoint(tmp_path, capsys):
    """It has no option: written by hand, kept where `gof convert` writes what else is known; the old option says so."""
    raw = lookalikes.yang(tmp_path / "chkpnt30000.pth")
    said = tmp_path / "chkpnt30000.pth.gof.json"
    said.write_text('{"schema": "gof-import", "version": 1, "code_date": "2024-09-14", "flame_only": true}')
    result = str(tmp_path / "chkpnt30000.pth")
    assert main(["convert", result, "--time-unit", "2"]) == 0
    assert "as chkpnt30000.pth.gof.json says: time unit 2 s" in " ".join(capsys.readouterr().out.split())
    about = json.loads(said.read_text())
    assert about["code_date"] == "2024-09-14" and about["time_unit_s"] == 2 and about["flame_only"]
    S = yang_covariance(raw, False)
    got = read_result(result).gaussians
    np.testing.assert_allclose(got.velocity, S[:, :3, 3] / S[:, 3, 3, None] / 2, rtol=1e-4, atol=1e-5)
    capsys.readouterr()
    assert main(["convert", result, "--code-date", "2024-09-14"]) == 1
    assert '"code_date": "2024-09-15"}' in " ".join(capsys.readouterr().err.split())


def test_yang_with_a_wider_window(tmp_path):
    """prefilter_var stands in cfg_args beside the checkpoint; it widens the temporal window and nothing else."""
    raw = lookalikes.yang(tmp_path / "chkpnt_best.pth")
    S = yang_covariance(raw)
    (tmp_path / "cfg_args").write_text("Namespace(sh_degree=3, source_path='a', prefilter_var=0.02, x=[1])")
    got = read_result(tmp_path)  # the folder's best, where it has no other
    np.testing.assert_allclose(got.gaussians.t_sigma, np.sqrt(S[:, 3, 3] + 0.02), rtol=1e-5)
    np.testing.assert_allclose(got.gaussians.velocity, S[:, :3, 3] / S[:, 3, 3, None], rtol=1e-4, atol=1e-5)
    assert not any("code_date" in note for note in got.notes)
    for text in ("Namespace(prefilter_var=-1.0)", "Namespace(a=-'b')", "import os", "Namespace(" * 9999, "\0", "f(x"):
        (tmp_path / "cfg_args").write_text(text)
        np.testing.assert_allclose(read_result(tmp_path).gaussians.t_sigma, np.sqrt(S[:, 3, 3]), rtol=1e-5)


def test_times_that_are_shares_of_the_clip_are_asked_about(tmp_path):
    """Trained on the D-NeRF layout of our own dataset: its time runs from 0 to 1 however long the clip is."""
    lookalikes.yang(tmp_path / "a.pth", n=300)
    clip = ImportOptions(frame_time_s=0.01, clip_s=(0.0, 0.35))
    with pytest.raises(DataFormatError, match=r"--time-unit.*0\.35 if they are shares"):
        read_result(tmp_path / "a.pth", clip)
    assert read_result(tmp_path / "a.pth", replace(clip, time_unit_s=0.35)).gaussians.t_mu.max() <= 0.35
    lookalikes.yang(tmp_path / "b.pth", n=300, times=(-0.03, 0.38))  # seconds, as its own initialisation spreads them
    read_result(tmp_path / "b.pth", clip)
    lookalikes.yang(tmp_path / "c.pth", n=300, times=(0, 35 / 30))  # frames at 30 a second, as n3v2blender writes
    with pytest.raises(DataFormatError, match="the clip lasts 0.35 s"):
        read_result(tmp_path / "c.pth", clip)


def test_yang_time_unit_and_the_3d_variant(tmp_path):
    raw = lookalikes.yang(tmp_path / "a.pth")
    a, b = (
        read_result(tmp_path / "a.pth").gaussians,
        read_result(tmp_path / "a.pth", ImportOptions(time_unit_s=0.5, time_zero_s=2)).gaussians,
    )
    np.testing.assert_allclose(b.velocity, 2 * a.velocity, rtol=1e-5)
    np.testing.assert_allclose(b.t_mu, 2 + 0.5 * raw["t"][:, 0], rtol=1e-5)
    lookalikes.yang(tmp_path / "b.pth", rot_4d=False)
    with pytest.raises(DataFormatError, match="rot_4d=False"):
        read_result(tmp_path / "b.pth")
