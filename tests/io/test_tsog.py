"""Files .tsog: ours by the formulas of the specification, one packed by hand by ours, and damaged ones."""

import io
import json
import zipfile

import numpy as np
import pytest
from PIL import Image

from gof.commands.convert import main
from gof.core.datum import Datum
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import C0
from gof.core.rotations import rotation_matrices
from gof.io import tsog
from gof.io.importers import ImportOptions, read_result
from tests.conftest import random_gaussians

START_S, CLIP_S = 0.2, 0.5
TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from Z up to the format's Y up


def moving(n=300, **changes):
    """Gaussians of every kind: some always on, some still, some of unknown uncertainty."""
    rng = np.random.default_rng(1)
    g = random_gaussians(n)
    sd = np.where(rng.random(n) < 0.2, np.inf, rng.uniform(0.1, 2, n))
    extra = {"gas_velocity": rng.normal(0, 2, (n, 3)), "velocity_sd": sd}
    datum = changes.pop("datum", None)
    return TransientGaussians(**g.arrays() | extra | changes, datum=datum)


def written(folder, g, name="a.tsog"):
    order = tsog.save(g, folder / name, START_S, START_S + CLIP_S, "gof: demo")
    return g[order], folder / name


def pixels(archive, name):
    return np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("RGBA")).reshape(-1, 4).astype(float)


def decoded(path):
    """What sections 4 to 7 of the specification make of a file, written after their formulas."""
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
        n = meta["count"]

        def pair(group, mins, maxs):
            low, high = (pixels(archive, name)[:n] for name in group["files"])
            share = (low + 256 * high)[:, : len(mins)] / 65535
            return np.array(mins) + (np.array(maxs) - mins) * share

        place = pair(meta["means"], meta["means"]["mins"], meta["means"]["maxs"])
        center, sigma = pair(meta["timeline"], meta["timeline"]["mins"], meta["timeline"]["maxs"]).T
        moves = meta["temporal"]["means"]
        velocity = pair(moves, moves["mins"][0], moves["maxs"][0])
        scale = np.exp(np.array(meta["scales"]["codebook"])[pixels(archive, "scales.webp")[:n, :3].astype(int)])
        base = pixels(archive, "sh0.webp")[:n]
        dc = np.array(meta["sh0"]["codebook"])[base[:, :3].astype(int)]
        turn = pixels(archive, "quats.webp")[:n]
        wxyz = np.zeros((n, 4))
        for row, (*codes, tag) in enumerate(turn):
            kept = (2 * np.array(codes) / 255 - 1) / np.sqrt(2)
            wxyz[row] = np.insert(kept, int(tag) - 252, np.sqrt(max(0, 1 - (kept**2).sum())))
    place = np.sign(place) * (np.exp(np.abs(place)) - 1)
    return meta, place, velocity, center, sigma, scale, base[:, 3] / 255, dc, wxyz


def test_the_specification_finds_our_gaussians(tmp_path):
    g, path = written(tmp_path, moving())
    meta, place, velocity, center, sigma, scale, alpha, dc, wxyz = decoded(path)
    assert meta["version"] == 4 and meta["profile"] == {"id": "org.opsiclear.tsog-playback", "version": 1}
    assert meta["playback"]["duration"] == pytest.approx(CLIP_S)
    for time_s in (START_S, 0.4, START_S + CLIP_S):
        t = (time_s - START_S) / CLIP_S
        wanted, fade = g.at(time_s)
        found = place + velocity * (t - center)[:, None]
        shown = alpha * np.exp(-0.5 * ((t - center) / sigma) ** 2)
        np.testing.assert_allclose(found[fade > 0.01], wanted[fade > 0.01] @ TURN.T, atol=3e-4)
        np.testing.assert_allclose(shown, fade, atol=0.006)
    np.testing.assert_allclose(velocity / CLIP_S, np.where(g.dynamic[:, None], g.velocity, 0) @ TURN.T, atol=1e-4)
    assert np.abs(np.log(scale / g.scale)).max() < 0.005 + 1e-6  # half a step of ln(10) / 255
    np.testing.assert_allclose(0.5 + C0 * dc, g.color, atol=0.5 / 255 + 1e-6)
    ours = TURN @ rotation_matrices(g.rotation.astype(float))
    wanted = ours @ (np.eye(3) * g.scale[:, None].astype(float) ** 2) @ ours.transpose(0, 2, 1)
    theirs = rotation_matrices(wxyz)
    found = theirs @ (np.eye(3) * scale[:, None] ** 2) @ theirs.transpose(0, 2, 1)
    assert (np.abs(found - wanted).max((1, 2)) < 0.03 * wanted.max((1, 2))).all()


def test_everything_comes_back(tmp_path):
    color = np.random.default_rng(3).normal(0, 0.4, (300, 9, 3))
    g, path = written(tmp_path, moving(color=color, datum=Datum((5e5, 4e6, 100.0), 1.7e9)))
    back = read_result(path)
    assert back.method == "gof" and back.notes == []
    back, moves = back.gaussians, g.dynamic
    assert back.datum == g.datum
    np.testing.assert_array_equal(back.dynamic, moves)
    fades = moves & np.isfinite(g.t_sigma)
    np.testing.assert_array_equal(np.isinf(back.t_sigma), ~fades)
    np.testing.assert_allclose(back.t_mu[fades], g.t_mu[fades], atol=2e-5)
    np.testing.assert_allclose(back.t_sigma[fades], g.t_sigma[fades], atol=1e-4)
    np.testing.assert_allclose(back.velocity[moves], g.velocity[moves], atol=1e-4)
    np.testing.assert_allclose(back.gas_velocity, g.gas_velocity, atol=2e-4)
    assert not back.velocity[~moves].any()
    np.testing.assert_array_equal(np.isinf(back.velocity_sd), np.isinf(g.velocity_sd))
    known = np.isfinite(g.velocity_sd)
    assert np.abs(np.log(back.velocity_sd[known] / g.velocity_sd[known])).max() < 0.028
    np.testing.assert_allclose(back.color, g.color, atol=0.02)
    for time_s in (0.3, 0.6):
        np.testing.assert_allclose(back.at(time_s)[0][fades], g.at(time_s)[0][fades], atol=3e-4)
    again = tmp_path / "b.tsog"
    tsog.save(g, again, START_S, START_S + CLIP_S, "gof: demo")
    third = tmp_path / "c.tsog"
    tsog.save(g, third, START_S, START_S + CLIP_S, "gof: demo")
    assert again.read_bytes() == third.read_bytes()


# Two Gaussians packed by hand. Places: the logarithm runs over -ln 2..ln 2, so that the ends are -1 and 1.
BY_HAND = {
    "version": 4,
    "count": 2,
    "means": {"mins": [-np.log(2)] * 3, "maxs": [np.log(2)] * 3, "files": ["low.webp", "high.webp"]},
    "scales": {"codebook": [np.log(0.1), np.log(0.2)], "files": ["scales.webp"]},
    "quats": {"files": ["quats.webp"]},
    "sh0": {"codebook": [0.0, 1.0], "files": ["sh0.webp"]},
    "timeline": {"type": 1, "mins": [0, 0.25], "maxs": [1, 0.5], "files": ["low.webp", "high.webp"]},
    "temporal": {"means": {"mins": [[-1, -1, -1]], "maxs": [[1, 1, 3]], "files": ["v.webp"]}},
}
PIXELS = {
    "low.webp": [[0, 255, 255, 255], [255, 0, 0, 255]],
    "high.webp": [[0, 255, 255, 255], [255, 0, 0, 255]],
    "scales.webp": [[0, 1, 0, 255], [1, 1, 0, 255]],
    "quats.webp": [[255, 127, 127, 252], [127, 127, 127, 255]],  # a quarter turn about x; a half turn about z
    "sh0.webp": [[1, 0, 0, 51], [0, 0, 1, 255]],
    "v.webp": [[0, 255, 0, 255], [255, 0, 255, 0]],  # its alpha means nothing
}


def packed(path, meta=BY_HAND, pictures=PIXELS, lossless=True):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, codes in pictures.items():
            data = io.BytesIO()
            picture = Image.fromarray(np.array([codes], np.uint8))
            picture.save(data, "WEBP", lossless=lossless, exact=True)
            archive.writestr(name, data.getvalue())
    return path


def test_a_file_packed_by_hand_is_read(tmp_path):
    path = packed(tmp_path / "theirs.tsog", BY_HAND | {"playback": {"duration": 2.0}, "unknown": [1]})
    imported = read_result(path, ImportOptions(time_zero_s=10.0))
    g = imported.gaussians
    assert imported.method == "tsog" and any("10 to 12 s" in note for note in imported.notes)
    back = TURN.T
    np.testing.assert_allclose(g.position, np.array([[-1, 1, 1], [1, -1, -1]]) @ back.T, atol=1e-6)
    np.testing.assert_allclose(g.velocity, np.array([[-1, 1, -1], [1, -1, 3]]) / 2 @ back.T, atol=1e-6)
    np.testing.assert_allclose(g.t_mu, [10, 12])
    np.testing.assert_allclose(g.t_sigma, [1.0, 0.5])
    np.testing.assert_allclose(g.opacity, [0.2, 1])
    np.testing.assert_allclose(g.color, [[0.5 + C0, 0.5, 0.5], [0.5, 0.5, 0.5 + C0]], atol=1e-6)
    spreads = rotation_matrices(g.rotation.astype(float))
    spreads = spreads @ (np.eye(3) * g.scale[:, None].astype(float) ** 2) @ spreads.transpose(0, 2, 1)
    wanted = [np.diag([0.01, 0.01, 0.04]), np.diag([0.04, 0.04, 0.01])]  # theirs, turned about x
    wanted = [back @ w @ back.T for w in wanted]
    np.testing.assert_allclose(spreads, wanted, atol=6e-4)
    assert g.dynamic.all() and g.gas_velocity is None
    assert read_result(packed(tmp_path / "b.tsog")).gaussians.t_mu[1] == pytest.approx(299 / 30)
    assert read_result(tmp_path / "b.tsog", ImportOptions(time_unit_s=0.5)).gaussians.t_mu[1] == pytest.approx(0.5)


def changed(**changes):
    return BY_HAND | changes


REFUSED = {
    "version": (changed(version=5), PIXELS, "version or profile"),
    "profile": (changed(profile={"id": "other", "version": 1}), PIXELS, "version or profile"),
    "still": ({k: v for k, v in BY_HAND.items() if k not in ("timeline", "temporal")}, PIXELS, "stands still"),
    "frames": (changed(timeline=BY_HAND["timeline"] | {"type": 0}), PIXELS, "frame after another"),
    "turning": (changed(temporal=BY_HAND["temporal"] | {"quats": {}}), PIXELS, "otherwise than evenly"),
    "too many": (changed(count=3), PIXELS, "of 2 x 1 px"),
    "no count": (changed(count="2"), PIXELS, "announces"),
    "codebook": (changed(sh0={"codebook": [0.0], "files": ["sh0.webp"]}), PIXELS, "codebook"),
    "bounds": (changed(means=BY_HAND["means"] | {"mins": [9, 9, 9]}), PIXELS, "wrong way round"),
    "width": (changed(timeline=BY_HAND["timeline"] | {"mins": [0, 0]}), PIXELS, "width in time"),
    "tag": (BY_HAND, PIXELS | {"quats.webp": [[0, 0, 0, 9], [0, 0, 0, 252]]}, "component of a rotation"),
    "absent": (BY_HAND, {k: v for k, v in PIXELS.items() if k != "v.webp"}, "lacks the file 'v.webp'"),
    "metadata": (changed(means=7), PIXELS, "do not fit"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused(tmp_path, kind):
    meta, pictures, said = REFUSED[kind]
    with pytest.raises(DataFormatError, match=said) as error:
        read_result(packed(tmp_path / "bad.tsog", meta, pictures))
    assert "bad.tsog" in str(error.value)


def test_lossy_pictures_and_other_files_are_refused(tmp_path):
    with pytest.raises(DataFormatError, match="no lossless WebP"):
        read_result(packed(tmp_path / "lossy.tsog", lossless=False))
    (tmp_path / "a.tsog").write_bytes(b"PK no")
    with pytest.raises(DataFormatError, match="damaged"):
        read_result(tmp_path / "a.tsog")


def test_damage_is_an_error_or_a_result_and_no_fault(tmp_path):
    rng, whole = np.random.default_rng(0), packed(tmp_path / "a.tsog").read_bytes()
    refused = 0
    for _ in range(150):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(256)
        (tmp_path / "bad.tsog").write_bytes(data)
        try:
            read_result(tmp_path / "bad.tsog")
        except GofError:
            refused += 1
    assert refused > 50


def test_too_many_sets_of_harmonics_are_rounded_to_fit(monkeypatch):
    monkeypatch.setattr(tsog, "PALETTE", 8)
    sh = np.random.default_rng(0).normal(0, 0.3, (40, 3, 3))
    found = tsog._PictureWriter(40).harmonics(sh)
    assert found["count"] <= 8 and found["bands"] == 1


def test_gof_convert_says_what_it_costs(tmp_path):
    moving(dynamic=np.ones(300, bool), t_sigma=np.full(300, 0.1)).save(tmp_path / "a.npz", "gof reconstruct made up")
    words = [str(tmp_path / "a.npz"), str(tmp_path / "a.tsog"), "--json", str(tmp_path / "j")]
    assert main([*words, "--clip", "0", "1"]) == 0
    said = " ".join(json.loads((tmp_path / "j").read_text())["notes"])
    assert "bytes" in said and "mm/s (rms" in said and " dB" in said and "y up" in said
    assert float(said.split("agree to ")[1].split()[0]) > 45
    with pytest.raises(DataFormatError, match="make no"):
        tsog.save(random_gaussians(3), tmp_path / "c.tsog", 1.0, 1.0, "")


@pytest.mark.parametrize("longest", [1e3, 1e6, np.inf])
def test_one_long_life_takes_no_digits_from_the_others(tmp_path, longest):
    lives = np.random.default_rng(2).uniform(0.03, 0.3, 300)
    lives[0] = longest
    g, path = written(tmp_path, moving(t_sigma=lives, dynamic=np.ones(300, bool)))
    back = read_result(path).gaussians
    short = g.t_sigma < 1
    np.testing.assert_allclose(back.t_sigma[short], g.t_sigma[short], rtol=0.01)
    assert np.isinf(back.t_sigma[~short]).all() and back.dynamic.all()
