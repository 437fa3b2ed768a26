"""GLB and PLY sequences, read back by rules written down here: glTF 2.0 and the text of KHR_gaussian_splatting."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from gof.commands.convert import main
from gof.core.errors import DataFormatError
from gof.io import convert, gltf
from gof.io.importers import ImportOptions, read_result
from gof.render.reference import rotation_matrix
from tests.conftest import random_gaussians

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
KHR = "KHR_gaussian_splatting"
# The extension's table of attributes: accessor type, and component types with whether they are normalised.
ALLOWED = {
    "ROTATION": ("VEC4", {(5126, False), (5120, True), (5122, True)}),
    "SCALE": ("VEC3", {(5126, False), (5121, False), (5121, True), (5123, False), (5123, True)}),
    "OPACITY": ("SCALAR", {(5126, False), (5121, True), (5123, True)}),
}
# (x, y, z) with Z up is (x, z, -y) with Y up.
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def parse(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """JSON and attributes of a GLB; every rule that is broken is an assertion."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert magic == b"glTF" and version == 2 and length == len(data)
    chunks, at = [], 12
    while at < len(data):
        size, kind = struct.unpack_from("<I4s", data, at)
        assert size % 4 == 0 and at % 4 == 0
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    assert [kind for kind, _ in chunks] == [b"JSON", b"BIN\0"] and at == len(data)
    content, binary = json.loads(chunks[0][1]), chunks[1][1]
    assert chunks[0][1].rstrip(b" ").endswith(b"}"), "JSON is filled up with blanks"
    assert content["asset"]["version"] == "2.0" and KHR in content["extensionsUsed"]
    assert len(content["buffers"]) == 1 and "uri" not in content["buffers"][0]
    assert 0 <= len(binary) - content["buffers"][0]["byteLength"] < 4
    (mesh,) = content["meshes"]
    (primitive,) = mesh["primitives"]
    assert content["nodes"][content["scenes"][content["scene"]]["nodes"][0]]["mesh"] == 0
    attributes = {name: accessor(content, binary, k) for name, k in primitive["attributes"].items()}
    assert len({len(values) for values in attributes.values()}) == 1, "all attributes have one count"
    check_splats(content, primitive, attributes)
    return content, attributes


def accessor(content: dict, binary: bytes, number: int) -> np.ndarray:
    a = content["accessors"][number]
    view = content["bufferViews"][a["bufferView"]]
    kind, width = np.dtype(COMPONENTS[a["componentType"]]), WIDTHS[a["type"]]
    start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
    assert start % kind.itemsize == 0 and view.get("byteOffset", 0) % 4 == 0
    assert (kind.itemsize * width) % 4 == 0, "each vertex begins at a multiple of four bytes"
    assert a["count"] * kind.itemsize * width <= view["byteLength"] and view["target"] == 34962
    assert view["byteOffset"] + view["byteLength"] <= len(binary)
    values = np.frombuffer(binary, kind, a["count"] * width, start).reshape(a["count"], width)
    assert np.isfinite(values).all(), "glTF has no NaN and no infinity"
    if "min" in a:
        assert np.array_equal(values.min(0), np.float32(a["min"])) and np.array_equal(
            values.max(0), np.float32(a["max"])
        )
    return values / np.iinfo(kind).max if a.get("normalized") else values


def check_splats(content: dict, primitive: dict, attributes: dict[str, np.ndarray]) -> None:
    """What the extension says of a primitive with the kernel "ellipse"."""
    extension = primitive["extensions"][KHR]
    assert primitive["mode"] == 0 and extension["kernel"] == "ellipse"
    assert extension["colorSpace"] in ("srgb_rec709_display", "lin_rec709_display")
    assert extension.get("projection", "perspective") == "perspective"
    assert "min" in content["accessors"][primitive["attributes"]["POSITION"]]
    for name in attributes:
        assert name in ("POSITION", "COLOR_0") or name.startswith((f"{KHR}:", "_")), f"{name}: own ones begin with _"
    for name, (kind, components) in ALLOWED.items():
        a = content["accessors"][primitive["attributes"][f"{KHR}:{name}"]]
        assert a["type"] == kind and (a["componentType"], a.get("normalized", False)) in components
    degrees = [d for d in range(4) if f"{KHR}:SH_DEGREE_{d}_COEF_0" in attributes]
    assert degrees == list(range(len(degrees))) and degrees
    for degree in degrees:
        for m in range(2 * degree + 1):
            a = content["accessors"][primitive["attributes"][f"{KHR}:SH_DEGREE_{degree}_COEF_{m}"]]
            assert a["type"] == "VEC3" and a["componentType"] == 5126
    opacity = attributes[f"{KHR}:OPACITY"]
    assert (opacity >= 0).all() and (opacity <= 1).all() and (attributes[f"{KHR}:SCALE"] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(attributes[f"{KHR}:ROTATION"], axis=-1), 1, atol=1e-6)


def khr(attributes, name):
    return attributes[f"{KHR}:{name}"].astype(np.float64)


def test_an_instant_is_that_of_the_gaussians(tmp_path):
    g = random_gaussians(200)
    gltf.save(g, tmp_path / "a.glb", 0.4, "test")
    content, attributes = parse((tmp_path / "a.glb").read_bytes())
    position, opacity = g.at(0.4)
    np.testing.assert_allclose(attributes["POSITION"], position @ Y_UP.T, atol=1e-6)
    np.testing.assert_allclose(khr(attributes, "OPACITY")[:, 0], opacity, atol=1e-6)
    # The covariance as the extension spells it: C C^T with q = x y z w.
    x, y, z, w = khr(attributes, "ROTATION").T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    C = np.moveaxis(np.array(rows), -1, 0) * khr(attributes, "SCALE")[:, None]
    axes = Y_UP @ (rotation_matrix(g.rotation.astype(np.float64)) * g.scale[:, None])
    np.testing.assert_allclose(C @ C.transpose(0, 2, 1), axes @ axes.transpose(0, 2, 1), atol=1e-8)
    color = 0.5 + 0.2820947917738781 * khr(attributes, "SH_DEGREE_0_COEF_0")
    np.testing.assert_allclose(color, g.color, atol=1e-6)
    linear = np.where(g.color <= 0.04045, g.color / 12.92, ((g.color + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(attributes["COLOR_0"], np.column_stack([linear, opacity]), atol=2 / 65535)
    assert content["meshes"][0]["primitives"][0]["extras"]["transient"] == {"version": 1, "time_s": 0.4}
    gltf.save(replace(g, emissive=True), tmp_path / "b.glb", 0.4, "test")
    content, _ = parse((tmp_path / "b.glb").read_bytes())
    assert content["meshes"][0]["primitives"][0]["extras"]["transient"]["emissive"] is True


def test_every_other_time_follows_from_the_file(tmp_path):
    """x(t) = POSITION + (t - time_s) _VELOCITY; opacity(t) = _PEAK_OPACITY exp(-(t - _T_MU)^2 / 2 _T_SIGMA^2)."""
    g = random_gaussians(200)
    gltf.save(g, tmp_path / "a.glb", 0.4)
    _, a = parse((tmp_path / "a.glb").read_bytes())
    t_mu, t_sigma = a["_T_MU"][:, 0].astype(np.float64), a["_T_SIGMA"][:, 0].astype(np.float64)
    for time_s in (-0.2, 0.0, 0.7):
        position, opacity = g.at(time_s)
        np.testing.assert_allclose(a["POSITION"] + (time_s - 0.4) * a["_VELOCITY"], position @ Y_UP.T, atol=1e-5)
        z = np.divide(time_s - t_mu, t_sigma, out=np.zeros(200), where=t_sigma > 0)  # 0: always on
        np.testing.assert_allclose(a["_PEAK_OPACITY"][:, 0] * np.exp(-0.5 * z * z), opacity, atol=1e-6)
    still = ~g.dynamic
    assert (a["_VELOCITY"][still] == 0).all() and (t_sigma[still] == 0).all()


def test_harmonics_keep_their_directions(tmp_path):
    """Degree 1 by the extension's own formula, for directions of a world with Y up."""
    g = random_gaussians(30, sh_coefficients=4)
    gltf.save(g, tmp_path / "a.glb", 0.0)
    _, a = parse((tmp_path / "a.glb").read_bytes())
    for direction in np.random.default_rng(0).normal(size=(5, 3)):
        d = direction / np.linalg.norm(direction)
        x, y, z = Y_UP @ d
        seen = 0.5 + 0.2820947917738781 * khr(a, "SH_DEGREE_0_COEF_0")
        for basis, m in ((-y, 0), (z, 1), (-x, 2)):
            seen = seen + 0.4886025119029199 * basis * khr(a, f"SH_DEGREE_1_COEF_{m}")
        own = 0.5 + 0.2820947917738781 * g.color[:, 0].astype(np.float64)
        for basis, k in ((-d[1], 1), (d[2], 2), (-d[0], 3)):
            own = own + 0.4886025119029199 * basis * g.color[:, k]
        np.testing.assert_allclose(seen, own, atol=1e-5)


@pytest.mark.parametrize("sh", [0, 9, 16])
def test_all_degrees_are_whole(tmp_path, sh):
    gltf.save(random_gaussians(7, sh_coefficients=sh), tmp_path / "a.glb", 0.0)
    _, attributes = parse((tmp_path / "a.glb").read_bytes())
    assert sum("SH_DEGREE" in name for name in attributes) == max(sh, 1)


def test_the_rules_can_be_broken(tmp_path):
    """Otherwise the tests above would prove nothing."""
    g = random_gaussians(5)
    gltf.save(g, tmp_path / "a.glb", 0.0)
    good = (tmp_path / "a.glb").read_bytes()
    for old, new in [
        (b'"mode":0', b'"mode":1'),
        (b'"ellipse"', b'"ellipsf"'),
        (b'"_VELOCITY"', b'"aVELOCITY"'),
        (b'"version":"2.0"', b'"version":"1.0"'),
        (b"SH_DEGREE_0_COEF_0", b"SH_DEGREE_1_COEF_0"),
    ]:
        assert old in good
        with pytest.raises((AssertionError, KeyError)):
            parse(good.replace(old, new))
    with pytest.raises(AssertionError):
        parse(good[:-4])


def test_the_command_chooses_an_instant_and_says_what_is_lost(tmp_path, capsys):
    g = replace(random_gaussians(40), color=np.tile([-0.2, 0.5, 0.5], (40, 1)))
    g.save(tmp_path / "g.npz")
    assert main([str(tmp_path / "g.npz"), str(tmp_path / "a.glb"), "--time", "0.25"]) == 0
    content, _ = parse((tmp_path / "a.glb").read_bytes())
    assert content["meshes"][0]["primitives"][0]["extras"]["transient"]["time_s"] == 0.25
    assert "100% of the Gaussians have a colour below 0" in " ".join(capsys.readouterr().out.split())
    assert main([str(tmp_path / "g.npz"), str(tmp_path / "b.glb")]) == 0
    content, _ = parse((tmp_path / "b.glb").read_bytes())
    middle = float(np.median(g.t_mu[g.dynamic]))
    assert content["meshes"][0]["primitives"][0]["extras"]["transient"]["time_s"] == pytest.approx(middle)
    with pytest.raises(DataFormatError, match="--time means"):
        main([str(tmp_path / "g.npz"), str(tmp_path / "c.npz"), "--time", "0"])


def test_an_instant_at_which_nothing_shines_is_noted(tmp_path, capsys):
    g = replace(random_gaussians(40), dynamic=np.ones(40, bool), t_sigma=np.full(40, 0.05))
    g.save(tmp_path / "g.npz")
    said = []
    for time_s in ("0.25", "99"):
        assert main([str(tmp_path / "g.npz"), str(tmp_path / f"{time_s}.glb"), "--time", time_s]) == 0
        said.append("no Gaussian can be seen at 99 s, but between" in " ".join(capsys.readouterr().out.split()))
    assert said == [False, True]


# ---------------------------------------------------------------- PLY sequences


def test_a_sequence_reads_back_as_the_same_motion(tmp_path):
    """By the importer of other methods' sequences: places, opacities, and velocities by differences."""
    g = random_gaussians(60)
    g = replace(g, t_sigma=np.where(np.isinf(g.t_sigma), 0.3, g.t_sigma))
    g.save(tmp_path / "g.npz")
    ask = [str(tmp_path / "g.npz"), str(tmp_path / "frames"), "--frame-time", "0.05", "--clip", "0.2", "0.6"]
    assert main(ask) == 0
    assert sorted(p.name for p in (tmp_path / "frames").iterdir()) == [f"frame{k:05d}.ply" for k in range(9)]
    back = read_result(tmp_path / "frames", ImportOptions(time_unit_s=0.05, time_zero_s=0.2)).gaussians
    times = 0.2 + 0.05 * np.arange(9)
    seen = np.max([g.at(t)[1] for t in times], axis=0) >= 1 / 255
    assert len(back) == seen.sum() < 60 or seen.all()
    for time_s in (0.2, 0.4, 0.6):
        position, opacity = g[seen].at(time_s)
        np.testing.assert_allclose(back.state_at(time_s).at(time_s)[0], position, atol=1e-5)
        np.testing.assert_allclose(back.state_at(time_s).at(time_s)[1], opacity, atol=1e-5)
    moving = np.where(g.dynamic[:, None], g.velocity, 0)[seen]
    np.testing.assert_allclose(back.state_at(0.4).velocity, moving, atol=1e-3)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ([], "need --frame-time"),
        (["--frame-time", "0.1"], "always on"),
        (["--frame-time", "0.1", "--clip", "90", "91"], "no Gaussian can be seen"),
        (["--frame-time", "1e-9", "--clip", "0", "1"], "frames from"),
        (["--frame-time", "0.1", "--clip", "1", "0"], "frames from"),
    ],
)
def test_a_sequence_that_cannot_be_is_refused(tmp_path, more, says):
    g = random_gaussians(20)
    if says == "no Gaussian can be seen":
        g = replace(g, dynamic=np.ones(20, bool), t_sigma=np.full(20, 0.1))
    g.save(tmp_path / "g.npz")
    with pytest.raises(DataFormatError, match=says):
        main([str(tmp_path / "g.npz"), str(tmp_path / "frames"), *more])
    assert not (tmp_path / "frames").exists()
    with pytest.raises(DataFormatError, match="exists already"):
        main([str(tmp_path / "g.npz"), str(tmp_path)])


def test_a_sequence_that_fails_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError("no room")

    monkeypatch.setattr(convert, "write", full)
    with pytest.raises(OSError, match="no room"):
        convert.save_frames(random_gaussians(20), tmp_path / "frames", 0.0, 0.1, 0.1)
    assert list(tmp_path.iterdir()) == []
