"""SPZ and SOG of an instant. SPZ is read here by its published layout, not by the library that wrote it."""

import gzip
import importlib.util
import re
import struct
from dataclasses import replace

import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.core.errors import DataFormatError, MissingDependencyError
from gof.core.gaussians import TransientGaussians
from gof.core.ply import Ply
from gof.core.zarr_array import ZarrArray
from gof.io import compressed
from tests.conftest import random_gaussians

needs_library = pytest.mark.skipif(
    importlib.util.find_spec("gaussforge") is None, reason="gaussforge is not installed: pip install '.[splats]'"
)


def read_spz(path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, 3), opacities (N,), constant harmonics (N, 3) and log scales (N, 3) of an .spz of version 2 or 3."""
    data = gzip.decompress(path.read_bytes())
    magic, version, count, _, bits, _, _ = struct.unpack("<IIIBBBB", data[:16])
    assert magic == 0x5053474E and version in (2, 3)
    at, parts = 16, []
    for width in (9, 1, 3, 3):
        parts.append(np.frombuffer(data, np.uint8, count * width, at).reshape(count, width).astype(np.int64))
        at += count * width
    place, alpha, color, scale = parts
    triples = place.reshape(count, 3, 3)
    fixed = triples[..., 0] | triples[..., 1] << 8 | triples[..., 2] << 16
    fixed = np.where(fixed >= 1 << 23, fixed - (1 << 24), fixed)
    return fixed / 2**bits, alpha[:, 0] / 255, (color / 255 - 0.5) / 0.15, scale / 16 - 10


@needs_library
def test_an_spz_holds_the_instant(tmp_path):
    g = random_gaussians(60)
    compressed.save(g, tmp_path / "a.spz", 0.05)
    position, opacity = g.at(0.05)
    seen = opacity >= 1 / 255
    place, alpha, harmonic, scale = read_spz(tmp_path / "a.spz")
    assert 0 < len(place) == seen.sum() < 61
    np.testing.assert_allclose(place, position[seen][:, [0, 2, 1]] * [1, 1, -1], atol=0.51 / 4096)  # Y up
    np.testing.assert_allclose(alpha, opacity[seen], atol=0.51 / 255 + 1e-6)
    np.testing.assert_allclose(scale, np.log(g.scale[seen]), atol=0.51 / 16)
    np.testing.assert_allclose(0.5 + 0.28209479 * harmonic, g.color[seen], atol=0.01)


@needs_library
def test_command_writes_both_and_says_what_is_lost(tmp_path, capsys):
    random_gaussians(60).save(tmp_path / "a.npz")
    for suffix, magic in ((".spz", b"\x1f\x8b"), (".sog", b"PK")):
        out = tmp_path / f"a{suffix}"
        assert gof(["convert", str(tmp_path / "a.npz"), str(out), "--time", "0.05"]) == 0
        assert out.read_bytes().startswith(magic)
    assert "motion is left out" in capsys.readouterr().out.replace("\n", " ")


@needs_library
def test_an_instant_at_which_nothing_is_seen_is_refused(tmp_path):
    g = random_gaussians(60)
    g = replace(g, t_sigma=np.full(60, 0.01))
    with pytest.raises(DataFormatError, match="no Gaussian can be seen at 1000"):
        compressed.save(g[g.dynamic], tmp_path / "a.spz", 1000.0)


def _still(position, **changes) -> TransientGaussians:
    """Grey Gaussians of 10 cm that never move."""
    n = len(position)
    return TransientGaussians(
        **{
            "position": np.array(position, np.float32),
            "velocity": np.zeros((n, 3)),
            "t_mu": np.zeros(n),
            "t_sigma": np.full(n, np.inf),
            "scale": np.full((n, 3), 0.1),
            "rotation": np.tile([1.0, 0, 0, 0], (n, 1)),
            "opacity": np.full(n, 0.9),
            "color": np.full((n, 3), 0.5),
            "dynamic": np.zeros(n, bool),
        }
        | changes
    )


def _converted(g: TransientGaussians, out, capsys, *options: str) -> tuple[int, str]:
    g.save(out.with_name("from.npz"))
    status = gof(["convert", str(out.with_name("from.npz")), str(out), *options])
    said = capsys.readouterr()
    return status, " ".join((said.out + said.err).split())


@needs_library
def test_what_an_spz_cannot_hold_is_said(tmp_path, capsys):
    """24 bits in steps of 1/4096 m reach 2048 m; 8 bits of ln sizes exp(-10) to exp(5.94); of colours -0.44 to 1.44."""
    places = [[1, 2, 3], [2047.9, 0, 0], [2048, 0, 0], [2500, 0, 10], [-3000, 5, 0], [0, 0, 0], [0, 0, 1]]
    scale, color = np.full((7, 3), 0.1), np.full((7, 3), 0.5)
    scale[5], scale[6], color[0] = 1000, 1e-6, (3, -2, 0.5)
    status, said = _converted(_still(places, scale=scale, color=color), tmp_path / "a.spz", capsys, "--time", "0")
    assert status == 0
    assert "3 Gaussians beyond the 2048 m" in said
    assert "sizes of 2 Gaussians are clipped" in said and "colours of 1 Gaussians are clipped" in said
    place, _, harmonic, log_scale = read_spz(tmp_path / "a.spz")
    np.testing.assert_allclose(place, [[1, 3, -2], [2047.9, 0, 0], [0, 0, 0], [0, 1, 0]], atol=0.51 / 4096)
    np.testing.assert_allclose(harmonic[0, :2], [0.5 / 0.15, -0.5 / 0.15], atol=1e-9)
    assert log_scale[2:, 0].tolist() == [5.9375, -10]


@needs_library
def test_an_spz_of_nothing_within_reach_is_refused(tmp_path, capsys):
    status, said = _converted(_still([[3000, 0, 0], [0, 5000, 0]]), tmp_path / "a.spz", capsys, "--time", "0")
    assert status == 1 and "all 2 Gaussians lie beyond the 2048 m" in said and not (tmp_path / "a.spz").exists()


@needs_library
def test_a_sog_says_how_far_it_rounds(tmp_path, capsys):
    """Read again with GaussForge, every place is as near as the note says."""
    import gaussforge

    places = np.array([[1, 2, 3], [2000, 0, 0], [2500, 0, 10], [-3000, 5, 0]])
    status, said = _converted(_still(places), tmp_path / "a.sog", capsys, "--time", "0")
    assert status == 0
    limit_m = float(re.search(r"rounded by up to ([0-9.e+-]+) mm", said)[1]) / 1000
    back = gaussforge.GaussForge().convert((tmp_path / "a.sog").read_bytes(), "sog", "ply")
    (tmp_path / "b.ply").write_bytes(bytes(back["data"]))
    found = Ply.read(tmp_path / "b.ply").columns("x", "y", "z")
    there = places[:, [0, 2, 1]] * [1, 1, -1]
    away = np.linalg.norm(found[:, None] - there, axis=-1).min(0)
    assert 0.1 < away.max() < limit_m * 3**0.5 < 1


@pytest.mark.parametrize("name", ["a.glb", "a.ply", "a.ftgs.ply", "frames"])
def test_values_beyond_the_format_are_refused(tmp_path, capsys, name):
    """A size that float32 holds and a speed that carries a place out of it."""
    g = _still([[0, 0, 0]], velocity=np.full((1, 3), 3e38), dynamic=np.ones(1, bool))
    options = {
        "a.glb": ["--time", "1e6"],
        "a.ftgs.ply": ["--clip", "0", "1e6"],
        "frames": ["--clip", "0", "1e6", "--frame-time", "1e6"],
        "a.ply": [],
    }[name]
    status, said = _converted(g, tmp_path / name, capsys, *options)
    if name == "a.ply":  # which holds it as it is
        assert status == 0
        return
    assert status == 1 and name in said and "holds" in said and "Traceback" not in said
    assert not (tmp_path / name).exists()


def test_an_empty_result_as_glb_is_refused(tmp_path, capsys):
    status, said = _converted(_still(np.zeros((0, 3))), tmp_path / "a.glb", capsys)
    assert status == 1 and "a.glb: the result holds no Gaussian" in said


def test_half_floats_do_not_overflow(tmp_path):
    array = ZarrArray.create(tmp_path / "a.zarr", (1, 2, 2, 2, 3), (1, 2, 2, 2, 3), "float16", {})
    with pytest.raises(DataFormatError, match=r"frame 0: 7e\+04 is beyond what float16 holds"):
        array.write(0, np.full((2, 2, 2, 3), 7e4))


def test_without_the_library_its_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gaussforge", None)
    with pytest.raises(MissingDependencyError, match="splats"):
        compressed.save(random_gaussians(5), tmp_path / "a.spz", 0.05)
