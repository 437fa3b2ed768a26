"""Files .4dgs: ours by the format's own reader, one of the format's own encoder by ours, and damaged ones."""

import base64
import json
import struct
import zlib

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.commands.convert import main
from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0, basis
from gof.core.rotations import rotation_matrices
from gof.io import fourdgs
from gof.io.convert import convert
from gof.io.importers import Imported, ImportOptions, read_result
from gof.io.importers.sidecar import with_sidecar
from tests.conftest import random_gaussians
from tests.io.stages import openusd

# Written by fourdgs 0.6.0 (Apache-2.0), profile "fine", of the numbers below: Y up, -z ahead, centimetres, harmonics of
# degree 1.
FOREIGN = zlib.decompress(
    base64.b85decode(
        "c-reUad8he<mF;)Wk3K~AT~)!FV-!nEXl~vQz%MJOD#&xOHNe)68R~qMYCptz)gD=s0Ijsr9B^zot{`)T%4Jhr<;^nRFVOaS2+Mx"
        "=m4SYpnMf5-vvsWI52`~W)%p{zy-vmd6{YXMY+0VhPVu?7Fp;1uxg2YNzt`m7jj$d|E&CY$u}v$UH}XV;50<t7Pvf2J>yQGF|0tG"
        "m{X9EC=6s6=ouIoTACS{TbLLd8k-xLnpm;{g>&;uGV}9TAPP*FfpkHBF_dcr;ufVR;m{72%`aht${Lt*0$Ih$i8-n9MX5QgP+?Oh"
        "kZ1<T_Xc1End!NSC<;Kfm1O3oA`D^?frbYoQWU~sNI?Kekdcv<2@(b^_N?2Hl_Ti@v0?Gr&4@}f0G-DSl2m~5E9O*RJoF*;maJ);"
        "QrjHmGiP{uc-Hvv<nX+i!;mAvx}OoIK^(3j`Ngio2M$~~dEmlT)ng3|Jq(s7nWdS47BGU;@gUSCCnNv^O^Jb*8D@wSLNXzt;^QM$"
        "W`P_A!82#hD0H<lGB{)~m$AT<N+Xp1_+CG4<HVC&>UntnOGqAIa4}?J$ezb~jFky$rvO~7_0bC-`X^3o6lCBFWAb6cbo}OogoKEr"
        "3~bMO9GWB#rLi!GPGFR0XJkZoymeudq9g<Bea0^wn6^B=fBwR$Ge-`vFmR+XMss5EdO|`Hkio&g%moZUup}o!5**Wv>{_r$1zFDt"
        "QX_#-^I-DDO$FSZS}U3x?F|CBnHh}F39sO=WWXNfKcUfk07|n!6BFZ3W{7|>Ec#(d?F}=kNl%X-U)~8VN&qwm-oy"
    )
)
PLACES_CM = np.array([[10, 20, -30], [0, 5, 0], [-10, 40, 20], [1, 2, 3]])
SCALES_CM = np.array([[1, 2, 3], [1, 1, 1], [2, 2, 4], [0.5, 1, 1]])
TURNS_XYZW = np.array([[0, 0, 0, 1], [0.5, 0.5, 0.5, 0.5], [0, 0.6, 0, 0.8], [1, 0, 0, 0]])
COLOURS = np.array([[1, 0.5, 0, 0.9], [0.2, 0.3, 0.4, 0.5], [0, 0, 1, 1], [0.9, 0.1, 0.6, 0.25]])
MOTIONS_CM_S = np.array([[100, 0, 0], [0, 150, 0], [0, 0, -50], [0, 0, 0]])
BORN_S, LIVES_S = np.array([0.1, 0.2, 0.15, 0.2]), np.array([0.02, 0.03, 0.04, np.inf])
BYTES = np.arange(36).reshape(4, 3, 3) * 7  # colour, coefficient
TO_OURS = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # x is x, -z is y, y is z


def moving(n=300, **changes) -> TransientGaussians:
    """Colours within [0, 1], and all that the format has no name for."""
    g = random_gaussians(n)
    rng = np.random.default_rng(1)
    values = g.arrays() | {
        "gas_velocity": rng.normal(0, 1, (n, 3)),
        "velocity_sd": np.where(rng.random(n) < 0.3, np.inf, rng.uniform(0.1, 2, n)),
    }
    return TransientGaussians(**values | changes)


def written(tmp_path, g, start_s=-1.0, end_s=2.0, name="a.4dgs"):
    """Gaussians in the file's order, and the file."""
    order = fourdgs.save(g, tmp_path / name, start_s, end_s, "gof: result.npz")
    return g[order], tmp_path / name


def test_what_comes_back_is_within_the_declared_errors(tmp_path):
    g, path = written(tmp_path, moving())
    imported = read_result(path)
    back = imported.gaussians
    assert imported.method == "gof" and not imported.notes
    near = {
        "position": 0.05 * np.median(g.scale) + 1e-6,
        "opacity": 1 / 255,
        "color": 1.5 / 255,
        "gas_velocity": 0.0251,
    }
    for name, most in near.items():
        assert np.abs(getattr(back, name) - getattr(g, name)).max() <= most + 1e-6, name
    live = g.dynamic & np.isfinite(g.t_sigma)
    for name, rows, most in (
        ("scale", slice(None), 0.03),
        ("t_sigma", live, 0.01),
        ("velocity_sd", slice(None), 0.052),
    ):
        one, other = getattr(g, name)[rows], getattr(back, name)[rows]
        np.testing.assert_array_equal(np.isinf(one), np.isinf(other))
        known = np.isfinite(one)
        assert np.abs(np.log(other[known] / one[known])).max() <= most, name
    np.testing.assert_array_equal(back.dynamic, g.dynamic)
    moves = g.dynamic
    assert np.abs(back.t_mu - g.t_mu)[moves].max() <= 0.0002 + 1e-6
    # The promise is on displacement: at most 4 mm/s for half a second, and as far for what is seen for less or longer.
    seen_s = np.clip(np.where(np.isfinite(g.t_sigma), 3.33 * g.t_sigma, 3.0), 0.02, 2.0)
    off = np.abs(back.velocity - g.velocity).max(1)
    assert (off * seen_s)[moves].max() <= 0.004 * 0.5 * 1.01
    assert not back.velocity[~moves].any()
    turned = np.abs((back.rotation * g.rotation).sum(1))
    assert np.degrees(2 * np.arccos(np.clip(turned, 0, 1))).max() < 2.5


def test_harmonics_datum_and_clock_come_back(tmp_path):
    color = np.random.default_rng(3).normal(0, 0.4, (300, 9, 3))
    g, path = written(tmp_path, moving(color=color, datum=Datum((5e5, 4e6, 100.0), 1.7e9)), start_s=-0.5)
    back = read_result(path, ImportOptions(time_zero_s=2.0)).gaussians
    assert back.datum == g.datum
    assert np.abs(back.t_mu - g.t_mu - 2.0)[g.dynamic].max() < 0.0003
    assert np.abs(back.color[:, 1:] - np.clip(g.color[:, 1:], -4, 4)).max() <= 4 / 255 + 1e-6
    plain = np.clip(0.5 + C0 * g.color[:, 0], 0, 1)
    assert np.abs(0.5 + C0 * back.color[:, 0] - plain).max() <= 1.5 / 255 + 1e-6


def test_a_file_of_the_formats_own_encoder_is_read(tmp_path):
    (tmp_path / "theirs.4dgs").write_bytes(FOREIGN)
    imported = read_result(tmp_path / "theirs.4dgs", ImportOptions(time_zero_s=1.0))
    g = imported.gaussians
    rows = [int(np.abs(g.position - p).sum(1).argmin()) for p in 0.01 * PLACES_CM @ TO_OURS.T]
    assert sorted(rows) == [0, 1, 2, 3] and imported.method == "4dgs"
    g = g[rows]
    np.testing.assert_allclose(g.position, 0.01 * PLACES_CM @ TO_OURS.T, atol=4e-4)
    np.testing.assert_allclose(g.velocity, 0.01 * MOTIONS_CM_S @ TO_OURS.T, atol=0.02)
    np.testing.assert_allclose(g.t_mu[:3], 1 + BORN_S[:3], atol=6e-4)
    np.testing.assert_allclose(g.t_sigma, LIVES_S, rtol=0.006)
    np.testing.assert_allclose(g.opacity, COLOURS[:, 3], atol=0.6 / 255)
    np.testing.assert_allclose(0.5 + C0 * g.color[:, 0], COLOURS[:, :3], atol=0.6 / 255)
    assert g.dynamic.tolist() == [True, True, True, False]
    R = TO_OURS @ rotation_matrices(TURNS_XYZW[:, [3, 0, 1, 2]])
    wanted = R @ (np.eye(3) * (0.01 * SCALES_CM[:, None]) ** 2) @ R.transpose(0, 2, 1)
    ours = rotation_matrices(g.rotation.astype(float))
    found = ours @ (np.eye(3) * g.scale[:, None].astype(float) ** 2) @ ours.transpose(0, 2, 1)
    np.testing.assert_allclose(found, wanted, atol=2e-5)
    direction = np.array([0.48, -0.6, 0.64])  # theirs
    values = np.array(basis(1, direction))[1:] @ (BYTES * 8 / 255 - 4).transpose(0, 2, 1)
    turned = np.array(basis(1, TO_OURS @ direction))[1:] @ g.color[:, 1:]
    np.testing.assert_allclose(turned, values, atol=1e-5)
    assert any("Z up" in note for note in imported.notes) and any("below 0.05" in note for note in imported.notes)


def test_the_formats_own_reader_and_validator_agree(tmp_path):
    reference = pytest.importorskip("fourdgs")  # pip install fourdgs, where the format itself is to be asked
    from fourdgs.validate import validate

    for k, color in enumerate((np.random.default_rng(0).random((300, 3)), np.full((300, 16, 3), 0.1))):
        g, path = written(tmp_path, moving(color=color), name=f"{k}.4dgs")
        report = validate(path.read_bytes())
        assert not [found for found in report.findings if found.severity != "note"]
        theirs, ours = reference.read(str(path)).gaussians, read_result(path).gaussians
        np.testing.assert_allclose(theirs.positions, ours.position, atol=1e-6)
        np.testing.assert_allclose(theirs.scales, ours.scale, rtol=1e-6)
        np.testing.assert_allclose(theirs.rotations, ours.rotation[:, [1, 2, 3, 0]], atol=1e-6)
        np.testing.assert_allclose(theirs.motions, ours.velocity, atol=1e-6)
        np.testing.assert_allclose(theirs.mu_t[g.dynamic] - 1.0, ours.t_mu[g.dynamic], atol=1e-6)
        live = g.dynamic & np.isfinite(g.t_sigma)
        np.testing.assert_allclose(theirs.sigma_t[live], ours.t_sigma[live], rtol=1e-6)
        assert np.isposinf(theirs.sigma_t[~live]).all()
        np.testing.assert_allclose(theirs.colors[:, 3], ours.opacity, atol=1e-6)
        assert theirs.sh_degree == (0, 3)[k]


def test_gof_convert_says_what_it_costs(tmp_path, capsys):
    g = moving(200, dynamic=np.ones(200, bool), t_sigma=np.full(200, 0.1))
    g.save(tmp_path / "a.npz", "gof reconstruct made up")
    g.color[:20] = 1.5
    g.save(tmp_path / "a.npz", "gof reconstruct made up")
    words = [str(tmp_path / "a.npz"), str(tmp_path / "a.4dgs"), "--json", str(tmp_path / "j")]
    assert main([*words, "--clip", "0", "1"]) == 0
    said = " ".join(json.loads((tmp_path / "j").read_text())["notes"])
    assert f"{(tmp_path / 'a.4dgs').stat().st_size:,} bytes" in said
    assert "colours of 20 of 200 Gaussians are clipped" in said and "mm/s (rms" in said and " dB" in said
    assert read_result(tmp_path / "a.4dgs").method == "gof", "drawn over plates, as what it was made of"
    main([str(tmp_path / "a.4dgs"), str(tmp_path / "b.npz")])
    np.testing.assert_array_equal(
        TransientGaussians.load(tmp_path / "b.npz").position, read_result(tmp_path / "a.4dgs").gaussians.position
    )
    with pytest.raises(DataFormatError, match="make no"):
        fourdgs.save(g, tmp_path / "c.4dgs", 1.0, 1.0, "")
    g.position[0] = 1e9
    with pytest.raises(DataFormatError, match="32 bits"):
        fourdgs.save(g, tmp_path / "c.4dgs", 0.0, 1.0, "")


def swapped(old: bytes, new: bytes) -> bytes:
    assert FOREIGN.count(old) == 1 and len(old) == len(new)
    return FOREIGN.replace(old, new)


REFUSED = {
    "another version": (FOREIGN.replace(b"4DGS1", b"4DGS2"), "another version"),
    "no such file": (b"PK" + FOREIGN[2:], "is no .4dgs file"),
    "cut off": (FOREIGN[:-30], "cut off"),
    "more behind it": (FOREIGN + b"x", "does not end"),
    "another model": (swapped(b"gaussian-birth", b"keyframe-delta"), "temporal model 'keyframe-delta'"),
    "another grid": (swapped(b"uniform-v1", b"uniform-v9"), "quantisation 'uniform-v9'"),
    "a mirrored world": (swapped(struct.pack("<4Bd", 1, 1, 5, 2, 0.01), struct.pack("<4Bd", 2, 1, 5, 2, 0.01)), "left"),
    "no frame": (swapped(struct.pack("<4Bd", 1, 1, 5, 2, 0.01), struct.pack("<4Bd", 1, 1, 4, 2, 0.01)), "no frame"),
    "a window inside": (
        swapped(struct.pack("<Idd", 1, 0, 0.4), struct.pack("<Idd", 1, 0, 0.15)),
        "by windows inside the scene",
    ),
    "two headers": (FOREIGN[:8] + 2 * FOREIGN[8 : 17 + struct.unpack_from("<Q", FOREIGN, 9)[0]] + FOREIGN[8:], "two"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(tmp_path, kind):
    data, said = REFUSED[kind]
    (tmp_path / "bad.4dgs").write_bytes(data)
    with pytest.raises(DataFormatError, match=said) as error:
        read_result(tmp_path / "bad.4dgs")
    assert "bad.4dgs" in str(error.value)


def test_damage_is_an_error_or_a_result_and_no_fault(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "bad.4dgs"
    refused = 0
    for _ in range(300):
        data = bytearray(FOREIGN)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            read_result(path)
        except GofError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize("dynamic", [30, 40])
@pytest.mark.parametrize("suffix", [".4dgs", ".usda", ".usdc", ".tsog"])
def test_gas_that_goes_through_light_that_stands_still_comes_back(tmp_path, suffix, dynamic):
    """Nothing but its being dynamic tells such a Gaussian from background."""
    if suffix.startswith(".usd"):
        openusd()
    still = {"velocity": np.zeros((40, 3)), "t_sigma": np.full(40, np.inf), "dynamic": np.arange(40) < dynamic}
    g = moving(40, **still)
    frames = {"frame_time_s": 0.1} if suffix.startswith(".usd") else {}
    convert(Imported(g, "gof", tmp_path / "r.npz"), tmp_path / f"a{suffix}", 0.0, 1.0, **frames)
    back = read_result(tmp_path / f"a{suffix}").gaussians
    assert back.dynamic.sum() == dynamic
    speeds = [np.sort(np.linalg.norm(each.moving_gas, axis=1)) for each in (g, back)]  # each format has its own order
    np.testing.assert_allclose(*speeds, atol=0.05)  # a .4dgs has steps of 0.05 m/s


def test_what_was_said_of_a_file_stays_until_it_is_said_otherwise(tmp_path, capsys):
    """A second `gof convert RESULT` keeps the clock of the first; --time-zero 0 is a clock, too."""
    random_gaussians(20).save(tmp_path / "a.npz")
    path = tmp_path / "x.4dgs"
    assert gof(["convert", str(tmp_path / "a.npz"), str(path), "--clip", "0", "1"]) == 0

    def first_s(file) -> float:
        return float(np.min(read_result(file, with_sidecar(file, ImportOptions())[0]).gaussians.t_mu))

    plain = first_s(path)
    for words, later in ((["--time-zero", "5"], 5), (["--flame-only"], 5), (["--time-zero", "0"], 0)):
        assert gof(["convert", str(path), *words]) == 0
        assert first_s(path) == pytest.approx(plain + later, abs=1e-3)
    assert with_sidecar(path, ImportOptions())[0].flame_only
    assert gof(["convert", str(path), "--time-zero", "5"]) == 0
    for more, later in (([], 5), (["--time-zero", "0"], 0)):
        capsys.readouterr()
        assert gof(["convert", str(path), str(tmp_path / "y.npz"), "--overwrite", *more]) == 0
        assert first_s(tmp_path / "y.npz") == pytest.approx(plain + later, abs=1e-3)
        assert "as x.4dgs.gof.json says: " in capsys.readouterr().out.replace("\n", " ")
