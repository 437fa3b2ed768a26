"""Files .dgs: ours by the format's layout and its own library, one of its own encoder by ours, and damaged ones."""

import base64
import json
import struct
import zlib

import numpy as np
import pytest

from gof.commands.convert import main
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.rotations import rotation_matrices
from gof.io import dgs
from gof.io.importers import ImportOptions, read_result
from tests.conftest import random_gaussians

START_S, CLIP_S = 0.2, 0.5
TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from Z up to the format's Y up

# Written by dgs-py 1.1.1 (MIT) of the numbers below, for a clip of 2 s; places are those at its begin.
FOREIGN = zlib.decompress(
    base64.b85decode(
        "c-l+PDJW(Xa9{ue2WB9_$Ot5+#Z?_RAw6rqv9a;~LfbC8nEpfiT3=tZJA3Ag?b$OvcC%*Av}0gs0O9>W<@O-WP#Ot1*sIJ~b#q=Ag!l"
        "iy$_$km|Leif{{Q~}_Giw3*v2#edmq+Y_vjS^gYz=+@c;i;99Ub|;y&-kRWk<LT4VRvh4*s*Tg_AOohX@}wXSa-&`yv&2SE0L+=FDF1J"
        "G@@3}^rV8`Voz"
    )
)
PLACES = np.array([[0.1, 0.2, 0.3], [-1, 0.5, 2], [0, 0, 0]])
MOTIONS = np.array([[1, -2, 0.5], [0, 0, 3], [0, 0, 0]])  # a clip
MIDDLES, WIDTHS = np.array([0.25, 0.5, 0.75]), np.array([0.1, 0.05, 0])  # of the clip
SIZES = np.array([[0.1, 0.2, 0.05], [0.02, 0.02, 0.02], [0.3, 0.1, 0.1]])
TURNS_XYZW = np.array([[0, 0, 0, 1], [0.5, -0.5, 0.5, -0.5], [0.6, 0, 0, 0.8]])
OPACITIES = np.array([0.2, 0.6, 1])
PLAIN = np.array([[0.04, -0.04, 0.19], [-0.7, -0.07, -0.37], [0.27, 0.03, -0.22]])  # harmonics of degree 0


def covariances(rotation, scale):
    R = rotation_matrices(np.asarray(rotation, float))
    return R @ (np.eye(3) * np.asarray(scale, float)[:, None] ** 2) @ R.transpose(0, 2, 1)


def moving(n=300, **changes):
    return TransientGaussians(**random_gaussians(n).arrays() | changes)


def written(folder, g, name="a.dgs"):
    order = dgs.save(g, folder / name, START_S, START_S + CLIP_S, "gof: demo")
    return g[order], folder / name


def test_the_layout_holds_our_gaussians(tmp_path):
    g, path = written(tmp_path, moving())
    data, n = path.read_bytes(), len(g)
    magic, version, clip_s, count, moves, degree = struct.unpack_from("<IIfIBI", data)
    assert magic == ord("s") << 24 | ord("p") << 16 | ord("l") << 8 | ord("g") and version == 1 << 22 | 1 << 12 | 1
    assert (clip_s, count, moves, degree) == (CLIP_S, n, 1, 0) and len(data) == 45 + 51 * n
    low, high, dark, light = struct.unpack_from("<4f", data, 21)
    means = np.frombuffer(data, "<f4", 4 * n, 45).reshape(n, 4).astype(float)
    words = np.frombuffer(data, "<u2", 6 * n, 45 + 16 * n).astype(float) / 65535
    size, turn = words[: 3 * n].reshape(n, 3), 2 * words[3 * n :].reshape(n, 3) - 1
    alpha = np.frombuffer(data, "u1", n, 45 + 28 * n) / 255
    colour = np.frombuffer(data, "<u2", 3 * n, 45 + 29 * n).reshape(n, 3) / 65535
    motion = np.frombuffer(data, "<f4", 4 * n, 45 + 35 * n).reshape(n, 4).astype(float)
    for time_s in (START_S, 0.4, START_S + CLIP_S):  # as its renderer does
        t = (time_s - START_S) / CLIP_S
        wanted, fade = g.at(time_s)
        np.testing.assert_allclose(means[:, :3] + t * motion[:, :3], wanted @ TURN.T, atol=2e-6)
        shown = alpha * np.exp(-((t - means[:, 3]) ** 2) / (2 * motion[:, 3] ** 2))
        np.testing.assert_allclose(shown, fade, atol=0.5 / 255 + 1e-6)
    assert (motion[:, 3] > 0).all(), "its sorting leaves out what has no width"
    np.testing.assert_allclose(np.exp(low + (high - low) * size), g.scale, rtol=1e-4)
    np.testing.assert_allclose(0.5 + C0 * (dark + (light - dark) * colour), g.color, atol=1e-5)
    left = 1 - (turn**2).sum(1)
    assert (left >= 0).all(), "its renderer takes the root"
    found = covariances(np.column_stack([np.sqrt(left), turn]), np.exp(low + (high - low) * size))
    wanted = TURN @ covariances(g.rotation, g.scale) @ TURN.T
    assert (np.abs(found - wanted).max((1, 2)) < 0.02 * wanted.max((1, 2))).all()


def test_it_comes_back(tmp_path):
    color = np.random.default_rng(3).normal(0, 0.4, (300, 9, 3))
    g, path = written(tmp_path, moving(color=color))
    back = read_result(path, ImportOptions(time_zero_s=START_S)).gaussians
    np.testing.assert_array_equal(back.dynamic, g.dynamic)
    fades = g.dynamic & np.isfinite(g.t_sigma)
    np.testing.assert_array_equal(np.isinf(back.t_sigma), ~fades)
    for name in ("position", "t_mu", "t_sigma"):
        np.testing.assert_allclose(getattr(back, name)[fades], getattr(g, name)[fades], atol=2e-6)
    np.testing.assert_allclose(back.velocity[g.dynamic], g.velocity[g.dynamic], atol=1e-6)
    np.testing.assert_allclose(back.color, g.color, atol=0.01)


def test_a_file_of_the_formats_own_encoder_is_read(tmp_path):
    (tmp_path / "theirs.dgs").write_bytes(FOREIGN)
    imported = read_result(tmp_path / "theirs.dgs", ImportOptions(time_zero_s=1.0))
    g, back = imported.gaussians, TURN.T
    assert imported.method == "dgs" and any("1 to 3 s" in note for note in imported.notes)
    places = PLACES + MOTIONS * MIDDLES[:, None]
    np.testing.assert_allclose(g.position, places @ back.T, atol=1e-6)
    np.testing.assert_allclose(g.velocity, MOTIONS / 2 @ back.T, atol=1e-6)
    np.testing.assert_allclose(g.t_mu, 1 + 2 * MIDDLES, atol=1e-6)
    np.testing.assert_allclose(g.t_sigma, [0.2, 0.1, np.inf], atol=1e-6)
    np.testing.assert_allclose(g.opacity, OPACITIES, atol=1.01 / 255)  # its encoder cuts off
    wanted = back @ covariances(TURNS_XYZW[:, [3, 0, 1, 2]], SIZES) @ back.T
    np.testing.assert_allclose(covariances(g.rotation, g.scale), wanted, rtol=2e-3, atol=2e-5)
    np.testing.assert_allclose(g.color[:, 0], PLAIN, atol=2e-5)
    assert g.color.shape == (3, 4, 3) and g.dynamic.tolist() == [True, True, False]
    slower = read_result(tmp_path / "theirs.dgs", ImportOptions(time_unit_s=4.0)).gaussians
    np.testing.assert_allclose(slower.velocity, g.velocity / 2, atol=1e-6)


def test_the_formats_own_library_agrees(tmp_path):
    library = pytest.importorskip("dgs", reason="pip install dgs-py, where the format itself is to be asked")
    g, path = written(tmp_path, moving(color=np.random.default_rng(0).normal(0, 0.3, (300, 16, 3))))
    theirs, metadata = library.decode(str(path))
    assert len(theirs) == len(g) and metadata.duration == CLIP_S
    library.encode(theirs, metadata, str(tmp_path / "again.dgs"))
    assert (tmp_path / "again.dgs").read_bytes() == path.read_bytes()


def at_place(place, replacement):
    return FOREIGN[:place] + replacement + FOREIGN[place + len(replacement) :]


REFUSED = {
    "no such file": (b"PK" + FOREIGN[2:], "is no .dgs"),
    "empty": (b"", "is no .dgs"),
    "another version": (at_place(4, struct.pack("<I", 2 << 22)), "version 2.0"),
    "still": (at_place(16, b"\0"), "stands still"),
    "without length": (at_place(8, struct.pack("<f", 0)), "--time-unit"),
    "degree": (at_place(17, struct.pack("<I", 9)), "no sense"),
    "bounds": (at_place(21, struct.pack("<f", 9)), "no sense"),
    "cut off": (FOREIGN[:-1], "cut off"),
    "count": (at_place(12, struct.pack("<I", 1 << 31)), "cut off"),
    "not finite": (at_place(45, struct.pack("<f", np.nan)), "position"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(tmp_path, kind):
    data, said = REFUSED[kind]
    (tmp_path / "bad.dgs").write_bytes(data)
    with pytest.raises(GofError, match=said) as error:
        read_result(tmp_path / "bad.dgs")
    assert "bad.dgs" in str(error.value)


def test_damage_is_an_error_or_a_result_and_no_fault(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "bad.dgs"
    refused = 0
    for _ in range(300):
        data = bytearray(FOREIGN)
        for at in rng.integers(0, 60, rng.integers(1, 4)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            read_result(path)
        except GofError:
            refused += 1
    assert refused > 100


def test_gof_convert_says_what_it_costs(tmp_path):
    n = 300
    gas = np.random.default_rng(0).normal(0, 1, (n, 3))
    g = moving(n, dynamic=np.ones(n, bool), t_sigma=np.full(n, 0.1), gas_velocity=gas)
    g.save(tmp_path / "a.npz", "gof reconstruct made up")
    words = [str(tmp_path / "a.npz"), str(tmp_path / "a.dgs"), "--json", str(tmp_path / "j")]
    assert main([*words, "--clip", "0.1", "1"]) == 0
    said = " ".join(json.loads((tmp_path / "j").read_text())["notes"])
    assert "51.1 a Gaussian" in said and "mm/s (rms" in said and "what the gas does (v_gas) is left out" in said
    assert float(said.split("agree to ")[1].split()[0]) > 50
    with pytest.raises(DataFormatError, match="make no"):
        dgs.save(g, tmp_path / "c.dgs", 1.0, 1.0, "")
