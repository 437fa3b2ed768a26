"""SPZ and SOG of an instant. SPZ is read here by its published layout, not by the library that wrote it."""

import gzip
import importlib.util
import struct
from dataclasses import replace

import numpy as np
import pytest

from gof.cli import main as gof
from gof.errors import DataFormatError, MissingDependencyError
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
    np.testing.assert_allclose(place, position[seen], atol=0.51 / 4096)
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


def test_without_the_library_its_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gaussforge", None)
    with pytest.raises(MissingDependencyError, match="splats"):
        compressed.save(random_gaussians(5), tmp_path / "a.spz", 0.05)
