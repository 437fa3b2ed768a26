"""Foreign files as exporters and editors leave them: both doors, the library's and the add-on's, decide alike."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.core.colmap import read_colmap
from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.io.importers.alignment import read_cameras
from gof_blender.core.errors import DataFormatError as AddOnError
from gof_blender.pure.io import camera_files

HEAD = "# Image list with two lines of data per image:\n"
ROWS = [f"{i} 1 0 0 0 {i} 0 0 1 cam_{i}.png" for i in (1, 2, 3)]
PAIRS = "".join(f"{row}\n\n" for row in ROWS)
THREE = {"cam_1": 1, "cam_2": 2, "cam_3": 3}
# What images.txt says, and the cameras in it by x of their translation, or what the refusal says.
IMAGES = {
    "as COLMAP writes it": (HEAD + PAIRS, THREE),
    "byte-order mark": ("\ufeff" + HEAD + PAIRS, THREE),
    "byte-order mark, no comment": ("\ufeff" + PAIRS, THREE),
    "CRLF": ((HEAD + PAIRS).replace("\n", "\r\n"), THREE),
    "CR": ((HEAD + PAIRS).replace("\n", "\r"), THREE),
    "Latin-1 comment": (b"# Gr\xf6\xdfe\n" + PAIRS.encode(), THREE),
    "indented comments, trailing blanks": ("  # a\n" + PAIRS.replace(".png", ".png \t"), THREE),
    "comment between": (PAIRS.replace("\n\n", "\n# seen: nothing\n\n"), THREE),
    "tabs": (PAIRS.replace(" ", "\t"), THREE),
    "an empty line after the comments": (HEAD + "\n" + PAIRS, THREE),
    "an empty line more at the end": (HEAD + PAIRS + "\n", THREE),
    "an empty line more everywhere": (PAIRS.replace("\n\n", "\n\n\n"), THREE),
    "no empty line at the end": ("\n\n".join(ROWS), THREE),
    "empty lines stripped": (HEAD + "\n".join(ROWS) + "\n", THREE),
    "an empty line stripped": (f"{ROWS[0]}\n{ROWS[1]}\n\n{ROWS[2]}\n\n", THREE),
    "observations": ("".join(f"{row}\n10.5 20.5 7 30.5 40.5 -1\n" for row in ROWS), THREE),
    "whole observations": ("".join(f"{row}\n100 200 7 300 400 -1 50 60 7 1 2 3\n" for row in ROWS), THREE),
    "some observations stripped": (f"{ROWS[0]}\n{ROWS[1]}\n1.5 2.5 -1\n{ROWS[2]}\n", THREE),
    "blank in the name": (PAIRS.replace("cam_", "left cam "), {f"left cam {i}": i for i in (1, 2, 3)}),
    "blanks in the name": (PAIRS.replace("cam_", "a  b "), {f"a  b {i}": i for i in (1, 2, 3)}),
    "blank in the folder": (PAIRS.replace("cam_", "fire take 2/cam_"), THREE),
    "a folder for every camera": (PAIRS.replace(".png", "/000001.png"), THREE),
    "backslashes": (PAIRS.replace("cam_", "shots\\cam_"), THREE),
    "backslashes, a folder for every camera": (PAIRS.replace(".png", "\\000001.png"), THREE),
    "names without a suffix": (PAIRS.replace("cam_", "cam.").replace(".png", ""), {f"cam.{i}": i for i in (1, 2, 3)}),
    "names of numbers": (PAIRS.replace("cam_", "").replace(".png", ""), {"1": 1, "2": 2, "3": 3}),
    "names of numbers, stripped": ("\n".join(ROWS).replace("cam_", "").replace(".png", ""), {"1": 1, "2": 2, "3": 3}),
    "names that may be observations": ("\n".join(ROWS).replace("cam_", "1 2 ").replace(".png", ""), "line 2 may be"),
    "one name twice": (PAIRS.replace("cam_2", "cam_1"), "cam_1"),
    "no number": (PAIRS.replace("2 1 0 0 0", "2 1 0 x 0"), "line 3"),
    "underscores": (PAIRS.replace("2 1 0 0 0", "2 1_0 0 0 0"), "line 3"),
    "cut off": (PAIRS[: PAIRS.index("cam_3") - 3], "line 5"),
    "NaN": (PAIRS.replace("2 1 0 0 0", "2 1 0 nan 0"), "line 3"),
    "observations twice": (f"{ROWS[0]}\n1 2 -1\n3 4 -1\n", "line 3"),
    "name in Latin-1": (PAIRS.replace("cam_2", "gr\xfcn").encode("latin-1"), "line 3"),
    "UTF-16": (PAIRS.encode("utf-16"), "UTF-16"),
    "UTF-16 without a mark": (PAIRS.encode("utf-16-le"), "UTF-16"),
}


def _colmap(folder: Path, images: str | bytes) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "images.txt").write_bytes(images if isinstance(images, bytes) else images.encode())
    (folder / "points3D.txt").write_text("")
    (folder / "cameras.txt").write_text("1 PINHOLE 100 80 90 90 50 40\n")
    return folder


def _by_gof(folder: Path) -> dict[str, float]:
    return {name: pose[0, 3] for name, pose in read_cameras(folder).items()}


def _by_the_addon(folder: Path) -> dict[str, float]:
    return {entry.name: entry.world_to_camera[0][3] for entry in camera_files.read(folder / "images.txt")}


DOORS = pytest.mark.parametrize("door", [_by_gof, _by_the_addon])


@DOORS
@pytest.mark.parametrize("name", IMAGES)
def test_pictures_of_a_text_model(tmp_path, door, name):
    text, expected = IMAGES[name]
    _colmap(tmp_path, text)
    if isinstance(expected, dict):
        assert door(tmp_path) == pytest.approx(expected)
        return
    with pytest.raises((DataFormatError, AddOnError), match=expected) as refusal:
        door(tmp_path)
    assert "images.txt" in str(refusal.value) or name == "one name twice"


@DOORS
@pytest.mark.parametrize("names", [["left cam 1.png", "left cam 2.png"], ["take 2/a.png", "take 2/b (1).png"]])
def test_a_text_model_of_pycolmap_with_blanks(tmp_path, door, names):
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(str(_colmap(tmp_path / "plain", "\n\n".join(ROWS[:2]) + "\n\n")))
    for number, name in enumerate(names, 1):
        model.images[number].name = name
    (tmp_path / "blanks").mkdir()
    model.write_text(str(tmp_path / "blanks"))
    assert door(tmp_path / "blanks") == {Path(name).stem: number for number, name in enumerate(names, 1)}


@pytest.mark.parametrize(
    "text, expected",
    [
        ("\ufeff# points\r\n\r\n7 1 2 3 0 0 0 0.5 1 0 2 4\r\n", [[1, 2, 3]]),
        ("1 1 2 3 0 0 0 0.5\n\n\n2 4 5 6 0 0 0 -1\n", [[1, 2, 3], [4, 5, 6]]),
        ("1 1 2 3\n", "line 1"),
        ("# a\n1 1 2 inf 0 0 0 0.5\n", "line 2"),
        ("1 1,5 2 3 0 0 0 0.5\n", "line 1"),
    ],
)
def test_points_of_a_text_model(tmp_path, text, expected):
    _colmap(tmp_path, PAIRS)
    (tmp_path / "points3D.txt").write_bytes(text.encode())
    if isinstance(expected, list):
        assert read_colmap(tmp_path)[1].tolist() == expected
    else:
        with pytest.raises(DataFormatError, match=rf"points3D\.txt.*{expected}"):
            read_colmap(tmp_path)


@pytest.mark.parametrize(
    "text, words",
    [
        ("\ufeff# lenses\r\n\r\n1 PINHOLE 100 80 90 90 50 40\r\n", None),
        ("1 PINHOLE 100 80 90 90 50 40\n1 PINHOLE 100 80 70 70 50 40\n", "line 2"),
        ("1 PINHOLE 100 80 90 90 50 40 0.1\n", "4 parameters"),
        ("1 SIMPLE_PINHOLE 100 80 90 90 50 40\n", "3 parameters"),
        ("1 OPENCV 100 80 90 90 50 40 0 0 0 0\n", "undistorter"),
        ("2 PINHOLE 100 80 90 90 50 40\n", "no camera 1"),
    ],
)
def test_lenses_of_a_text_model(tmp_path, text, words):
    _colmap(tmp_path, PAIRS)
    (tmp_path / "cameras.txt").write_bytes(text.encode())
    if words is None:
        assert _by_the_addon(tmp_path) == THREE
    else:
        with pytest.raises(AddOnError, match=words):
            _by_the_addon(tmp_path)


def test_pictures_of_one_name_that_stand_apart(tmp_path):
    """Two cameras never become one: the library refuses, the add-on tells them apart."""
    _colmap(tmp_path, "".join(f"{i} 1 0 0 0 {i} 0 0 1 rig_{i}/left/1.png\n\n" for i in (1, 2)))
    with pytest.raises(DataFormatError, match="stand apart"):
        _by_gof(tmp_path)
    assert _by_the_addon(tmp_path) == {"left": 1, "left_2": 2}


@pytest.mark.parametrize("lens", ["PINHOLE 100 80 90 91 50 40", "SIMPLE_PINHOLE 100 80 90 50 40"])
def test_a_binary_model_in_the_add_on(tmp_path, lens):
    pycolmap = pytest.importorskip("pycolmap")
    text = _colmap(tmp_path / "text", PAIRS)
    (text / "cameras.txt").write_text(f"1 {lens}\n")
    model, binary = pycolmap.Reconstruction(str(text)), tmp_path / "binary"
    binary.mkdir()
    model.write_binary(str(binary))
    found = camera_files.read(binary / "images.bin")
    assert {entry.name: entry.world_to_camera[0][3] for entry in found} == THREE
    fx, fy = (90, 91) if lens.startswith("PIN") else (90, 90)
    assert {(e.width, e.height, e.K) for e in map(_hashable, found)} == {
        (100, 80, ((fx, 0, 50), (0, fy, 40), (0, 0, 1)))
    }
    (binary / "cameras.bin").write_bytes((binary / "cameras.bin").read_bytes()[:-3])
    with pytest.raises(AddOnError, match=r"cameras\.bin: the COLMAP model cannot be read"):
        camera_files.read(binary / "cameras.bin")


def _hashable(entry):
    return replace(entry, K=tuple(map(tuple, entry.K)))


def test_a_binary_model_with_distortion_in_the_add_on(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    text = _colmap(tmp_path / "text", PAIRS)
    (text / "cameras.txt").write_text("1 OPENCV 100 80 90 90 50 40 0.1 0 0 0\n")
    (tmp_path / "binary").mkdir()
    pycolmap.Reconstruction(str(text)).write_binary(str(tmp_path / "binary"))
    with pytest.raises(AddOnError, match="image_undistorter"):
        camera_files.read(tmp_path / "binary/cameras.bin")


def test_the_model_with_most_pictures_is_read(tmp_path):
    """COLMAP writes a model for every part of the pictures that it could not join, in no order of size."""
    from gof.core.colmap import name_model

    _colmap(tmp_path / "sparse/0", "\n\n".join(ROWS[:2]))
    _colmap(tmp_path / "sparse/1", PAIRS)
    _colmap(tmp_path / "sparse/10", "\n\n".join(ROWS[:1]))
    assert _by_gof(tmp_path) == THREE
    assert all(word in name_model(tmp_path) for word in ("sparse/1 (", "sparse/0 has 2", "sparse/10 has 1"))
    assert name_model(tmp_path / "sparse/0") == str(tmp_path / "sparse/0")


# ---------------------------------------------------------------- JSON


@pytest.mark.parametrize(
    "data, words",
    [
        ("\ufeff{}".encode(), None),
        (b'\xef\xbb\xbf{\r\n"a": 1}\r\n', None),
        ("{}".encode("utf-16"), "UTF-16"),
        ("{}".encode("utf-16-le"), "UTF-16"),
        ("{}".encode("utf-32"), "UTF-16 or UTF-32"),
        ('{"a": "\xfc"}'.encode("latin-1"), "not UTF-8"),
        (b"", "empty"),
        (b"\xef\xbb\xbf", "empty"),
        (b'{"a": [{"b": NaN}]}', r"'a\[0\]\.b'"),
        (b'{"a": {"b": [0, -Infinity]}}', r"'a\.b\[1\]'"),
        (b'{"a": 1e999}', "'a'"),
        (b'{"a": 1' + b"0" * 400 + b"}", "'a'"),
        (b'{"a": [-1' + b"0" * 5000 + b"]}", r"'a\[0\]'"),
        (b'{"cam": 1, "cam": 2}', "'cam' stands twice"),
        (b'{"a": 1', "cut off"),
    ],
)
def test_json_of_editors_and_programs(tmp_path, data, words):
    path = tmp_path / "x.json"
    path.write_bytes(data)
    if words is None:
        assert read_json(path) in ({}, {"a": 1})
        return
    with pytest.raises(DataFormatError, match=words) as refusal:
        read_json(path)
    assert str(path) in str(refusal.value)


def test_whole_numbers_keep_their_digits(tmp_path):
    (tmp_path / "x.json").write_text(json.dumps({"a": [2**64 + 1, -(10**300), 0]}))
    assert read_json(tmp_path / "x.json") == {"a": [2**64 + 1, -(10**300), 0]}


def test_json_is_read_in_one_place_a_side():
    """So that no reader meets a number that is none, or one that no float can hold."""
    found = [
        path.as_posix()
        for folder in ("gof", "blender_addon", "benchmark")
        for path in sorted(Path(__file__).parents[2].joinpath(folder).rglob("*.py"))
        if "evidence" not in path.parts
        and re.search(r"json\.loads?\([^\n]*read_(text|bytes)|json\.load\(", path.read_text())
    ]
    assert not found


@pytest.mark.parametrize("digits", [400, 5000])
def test_a_number_beyond_floats_is_refused_by_commands(tmp_path, capsys, digits):
    """Where a Python integer became a float, so that the commands ended in an OverflowError."""
    from gof.commands.cli import main

    number = "1" + "0" * digits
    (tmp_path / "poses.json").write_text('{"cam_0": [[' + number + "]]}")
    (tmp_path / "spec.json").write_text('{"schema": "gof-scene", "version": 3, "name": "a", "fps": ' + number + "}")
    (tmp_path / "transforms.json").write_text('{"w": ' + number + ', "frames": []}')
    assert main(["generate", str(tmp_path / "spec.json"), "--out", str(tmp_path / "out")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "spec.json" in said and "'fps'" in said and len(said) < 500
    with pytest.raises(DataFormatError, match=r"poses\.json.*'cam_0\[0\]\[0\]'"):
        read_cameras(tmp_path / "poses.json")
    with pytest.raises(AddOnError, match=r"transforms\.json.*'w'"):
        camera_files.read(tmp_path / "transforms.json")


def test_a_broken_brightness_is_named_by_its_file(tmp_path):
    from gof_blender.core.checked_json import SpecError
    from gof_blender.pure.brightness import Brightness

    (tmp_path / "brightness.json").write_text('{"flame": "much", "clipped": 0, "dark": 0}')
    with pytest.raises(SpecError, match=r"brightness\.json: "):
        Brightness.read(tmp_path / "brightness.json")


def test_a_number_beyond_floats_in_a_spec_of_a_script():
    from gof_blender.pure.spec import SceneSpec, SpecError

    with pytest.raises(SpecError, match="frames|fps|number") as refusal:
        SceneSpec.from_dict({"schema": "gof-scene", "version": 3, "name": "a", "fps": 10**5000})
    assert len(str(refusal.value)) < 200


# ---------------------------------------------------------------- transforms.json


def _transforms(path: Path, **changes) -> Path:
    """Cameras in OpenGL's axes: at (0, -3, k), looking along +y, with z up."""
    turn = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    frames = [
        {
            "file_path": f"images/cam_{k}.png",
            "transform_matrix": [[*r, p] for r, p in zip(turn, (0, -3, k), strict=True)],
        }
        for k in range(3)
    ]
    for frame in frames:
        frame["transform_matrix"].append([0, 0, 0, 1])
    path.write_text(json.dumps({"w": 640, "h": 480, "fl_x": 500, "frames": frames} | changes))
    return path


def test_transforms_json_tells_where_cameras_are(tmp_path):
    """The point one metre before each camera, by hand: it looks along +y, so in OpenCV's axes it is at z = 1."""
    path = _transforms(tmp_path / "transforms.json")
    ours, theirs = read_cameras(path), {e.name: np.array(e.world_to_camera) for e in camera_files.read(path)}
    assert list(ours) == list(theirs) == ["cam_0", "cam_1", "cam_2"]
    for k, name in enumerate(ours):
        np.testing.assert_allclose(ours[name] @ [0.25, -2, k, 1], [0.25, 0, 1, 1], atol=1e-12)
        np.testing.assert_allclose(theirs[name], ours[name], atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"camera_model": "OPENCV_FISHEYE"},
        {"camera_model": "EQUIRECTANGULAR"},
        {"is_fisheye": True},
        {"k5": 0.1},
        {"distortion_params": [0, 0, 0.1]},
        {"ftheta_p0": 0.1},
        {"rolling_shutter": [0, 0, 0.01]},
    ],
)
def test_lenses_that_blender_has_not(tmp_path, changes):
    path = _transforms(tmp_path / "transforms.json", **changes)
    with pytest.raises(AddOnError, match=next(iter(changes))):
        camera_files.read(path)


def test_both_angles_of_view_count(tmp_path):
    path = _transforms(tmp_path / "transforms.json", camera_angle_x=math.pi / 2, camera_angle_y=2 * math.atan(0.5))
    whole = json.loads(path.read_text())
    del whole["fl_x"]
    path.write_text(json.dumps(whole))
    camera = camera_files.read(path)[0]
    assert (camera.K[0][0], camera.K[1][1]) == pytest.approx((320, 480))


# ---------------------------------------------------------------- PLYs of Gaussians

NAMES = [
    *"xyz",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
    *(f"rot_{i}" for i in range(4)),
]
ROW = (0, 0, 1, 0.5, 0.5, 0.5, 0.3, -3, -3, -3, 1, 0, 0, 0)
TYPES = "".join(f"property float {name}\n" for name in NAMES)


def _rows(count: int = 5, **cells: dict[int, float]) -> np.ndarray:
    """Good rows, but for cells: by property, the value by row."""
    rows = np.tile(np.array(ROW, "<f4"), (count, 1))
    rows[:, 0] = np.arange(count)
    for name, values in cells.items():
        for row, value in values.items():
            rows[row, NAMES.index(name)] = value
    return rows


def _binary(
    rows: np.ndarray, comment: bytes = b"", end: bytes = b"\n", before: bytes = b"", skipped: bytes = b""
) -> bytes:
    head = b"ply\nformat binary_little_endian 1.0\n" + comment + before
    head += f"element vertex {len(rows)}\n{TYPES}end_header\n".encode()
    return head.replace(b"\n", end) + skipped + rows.astype("<f4").tobytes()


def _text(rows: np.ndarray, end: str = "\n", blank: str = "") -> bytes:
    lines = [" ".join(map(str, row)) for row in rows.tolist()]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{TYPES}end_header\n"
    return (head + f"\n{blank}".join(lines) + "\n").replace("\n", end).encode()


def _doubles(rows: np.ndarray) -> bytes:
    head = f"ply\nformat binary_big_endian 1.0\nelement vertex {len(rows)}\n{TYPES}end_header\n"
    return head.replace("float", "double").encode() + rows.astype(">f8").tobytes()


CHUNK = b"element chunk 2\nproperty float min_x\nproperty uchar flag\n"
# The bytes of a PLY, and its x and the least and largest size and opacity of row 2, or what the refusal says.
GOOD = (math.exp(-3), math.exp(-3), 1 / (1 + math.exp(-0.3)))
PLYS = {
    "as trainers write it": (_binary(_rows()), GOOD),
    "CRLF header": (_binary(_rows(), end=b"\r\n"), GOOD),
    "CR header": (_binary(_rows(), end=b"\r"), GOOD),
    "Latin-1 comment": (_binary(_rows(), comment=b"comment Gr\xf6\xdfe\nobj_info \xb5\n"), GOOD),
    "UTF-8 comment": (_binary(_rows(), comment="comment Größe\n".encode()), GOOD),
    "text": (_text(_rows()), GOOD),
    "text, CRLF": (_text(_rows(), end="\r\n"), GOOD),
    "text, empty lines": (_text(_rows(), blank=" \n"), GOOD),
    "doubles, big-endian": (_doubles(_rows()), GOOD),
    "another element first": (_binary(_rows(), before=CHUNK, skipped=bytes(10)), GOOD),
    "flat": (_binary(_rows(scale_2={2: -np.inf})), (math.exp(-80), *GOOD[1:])),
    "flat, text": (_text(_rows(scale_2={2: -np.inf})), (math.exp(-80), *GOOD[1:])),
    "opaque": (_binary(_rows(opacity={2: np.inf})), (*GOOD[:2], 1)),
    "dead": (_binary(_rows(opacity={2: -np.inf})), (*GOOD[:2], 0)),
    "the largest": (_binary(_rows(scale_1={2: 29})), (GOOD[0], math.exp(29), GOOD[2])),
    "too large": (_binary(_rows(scale_1={2: 30})), r"'scale'.*rows \[2\]"),
    "huge": (_binary(_rows(scale_1={2: 100})), r"'scale'.*rows \[2\]"),
    "endless": (_binary(_rows(scale_1={2: np.inf})), r"'scale'.*rows \[2\]"),
    "size NaN": (_binary(_rows(scale_1={2: np.nan, 4: np.nan})), r"'scale'.*rows \[2, 4\]"),
    "place NaN": (_binary(_rows(x={3: np.nan})), r"'position'.*rows \[3\]"),
    "place infinite": (_text(_rows(y={1: -np.inf})), r"'position'.*rows \[1\]"),
    "colour infinite": (_binary(_rows(f_dc_1={1: np.inf})), r"'color'.*rows \[1\]"),
    "opacity NaN": (_binary(_rows(opacity={0: np.nan})), r"'opacity'.*rows \[0\]"),
    "turn NaN": (_binary(_rows(rot_2={4: np.nan})), r"'rotation'.*rows \[4\]"),
    "no turn": (_binary(_rows(rot_0={1: 0})), r"rows \[1\]"),
    "activated": (_binary(_rows(**{f"scale_{i}": dict.fromkeys(range(5), 0.05) for i in range(3)})), "activated"),
    "opacities activated": (_binary(_rows(200, opacity={k: k / 199 for k in range(200)})), "activated"),
    "underscores": (_text(_rows()).replace(b"-3.0", b"-3_0"), "line "),
    "decimal commas": (_text(_rows()).replace(b"-3.0", b"-3,0"), "line "),
    "cut off": (_binary(_rows())[:-3], "truncated"),
    "text cut off": (_text(_rows())[:-60], "truncated|line "),
}


def _splats_by_gof(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from gof.core.ply import Ply

    values = Ply.read(path).splats()
    return values["position"], values["scale"], values["opacity"]


def _splats_by_the_addon(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from gof_blender.pure.io.cloud import load

    cloud = load(path)
    return cloud.position, cloud.scale, cloud.opacity


SPLAT_DOORS = pytest.mark.parametrize("door", [_splats_by_gof, _splats_by_the_addon])


@SPLAT_DOORS
@pytest.mark.parametrize("name", PLYS)
def test_plys_of_gaussians(tmp_path, door, name):
    data, expected = PLYS[name]
    (tmp_path / "a.ply").write_bytes(data)
    if isinstance(expected, tuple):
        position, scale, opacity = door(tmp_path / "a.ply")
        assert position[:, 0].tolist() == [0, 1, 2, 3, 4]
        assert (scale[2].min(), scale[2].max(), opacity[2]) == pytest.approx(expected, rel=1e-6)
        return
    with pytest.raises((DataFormatError, AddOnError), match=expected) as refusal:
        door(tmp_path / "a.ply")
    assert "a.ply" in str(refusal.value)


def test_rows_of_the_file_are_named_also_of_every_third(tmp_path):
    from gof_blender.pure.io.cloud import load

    (tmp_path / "a.ply").write_bytes(_binary(_rows(9, x={6: np.nan})))
    with pytest.raises(AddOnError, match=r"rows \[6\]"):
        load(tmp_path / "a.ply", step=3)


def _properties(names: list[str], kind: str = "float") -> str:
    return "".join(f"property {kind} {name}\n" for name in names)


def _ply_of(properties: str, row: bytes) -> bytes:
    return f"ply\nformat binary_little_endian 1.0\nelement vertex 2\n{properties}end_header\n".encode() + 2 * row


PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
RGB = _properties([n for n in NAMES if "f_dc" not in n]) + _properties(["red", "green", "blue"], "uchar")
SURFELS = _properties([n for n in NAMES if n != "scale_2"])
STRANGERS = {
    "editor.compressed.ply": (_ply_of(_properties(PACKED, "uint"), bytes(16)), "SuperSplat's compressed PLY"),
    "points.ply": (_ply_of(_properties(list("xyz")) + _properties(["red"], "uchar"), bytes(13)), "points or a mesh"),
    "rgb.ply": (_ply_of(RGB, np.array(ROW[:3] + ROW[6:], "<f4").tobytes() + bytes(3)), "plain colours"),
    "surfels.ply": (_ply_of(SURFELS, np.array(ROW[:9] + ROW[10:], "<f4").tobytes()), "surfels"),
    "web.splat": (bytes(64), "antimatter15"),
    "phone.spz": (b"\x1f\x8b" + bytes(40), "SPZ"),
    "scene.ksplat": (bytes(4096), "mkkellogg"),
    "scene.SOG": (b"PK" + bytes(40), "SOG"),
}


@pytest.mark.parametrize("name", STRANGERS)
def test_files_of_other_splat_programs_are_named(tmp_path, capsys, name):
    from gof.commands.cli import main
    from gof_blender.pure.io.cloud import load

    data, words = STRANGERS[name]
    (tmp_path / name).write_bytes(data)
    assert main(["convert", str(tmp_path / name), str(tmp_path / "x.npz")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert name in said and words in said and re.search("export|give", said)
    with pytest.raises(AddOnError, match=words):
        load(tmp_path / name)


def test_a_folder_of_activated_plys_is_refused(tmp_path, capsys):
    from gof.commands.cli import main

    (tmp_path / "frames").mkdir()
    for k in range(3):
        data, _ = PLYS["activated"]
        (tmp_path / f"frames/time_{k:05d}.ply").write_bytes(data)
    assert main(["convert", str(tmp_path / "frames"), str(tmp_path / "x.npz"), "--time-unit", "1"]) == 1
    assert "time_00000.ply: all 'opacity' lie in 0..1 and all 'scale' are above 0" in " ".join(
        capsys.readouterr().err.split()
    )


@SPLAT_DOORS
def test_properties_that_nobody_reads_are_refused(tmp_path, door):
    """Mip-Splatting's filter_3D widens every Gaussian; who leaves it aside draws other sizes."""
    from gof.io.importers import ImportOptions, read_result
    from gof_blender.pure.io.cloud import load

    head = _properties(NAMES) + "property float filter_3D\n"
    for k in range(2):
        row = np.array([*ROW, 0.01], "<f4")
        row[0] = k
        (tmp_path / f"time_{k:05d}.ply").write_bytes(_ply_of(head, row.tobytes()))
    with pytest.raises((DataFormatError, AddOnError), match=r"time_0000\d\.ply: properties \['filter_3D'\]"):
        if door is _splats_by_gof:
            read_result(tmp_path, ImportOptions(time_unit_s=0.1))
        else:
            load(tmp_path / "time_00000.ply")


# ---------------------------------------------------------------- what other fields say

FTGS = "ftgs_version 1|time_units normalized|use_velocity 1|min_duration 0.02|n_frames 11"
FTGS_NAMES = [*NAMES, "time", "log_duration", "velocity_0", "velocity_1", "velocity_2"]
FTGS_SAYS = {
    "as vanilla": ("", 3.0),
    "said to be vanilla": ("duration_activation exp|use_marginal_gating 0|use_color_velocity false", 3.0),
    "true": ("use_velocity true", 3.0),
    "off": ("use_velocity 0", 0.0),
    "perhaps": ("use_velocity perhaps", "use_velocity|perhaps"),
    "sigmoid": ("duration_activation sigmoid", "duration_activation"),
    "gates": ("use_marginal_gating 1", "use_marginal_gating"),
    "colours that move": ("use_color_velocity true", "use_color_velocity"),
    "seconds": ("time_units seconds", "time_units seconds"),
    "version 2": ("ftgs_version 2", "ftgs_version 2"),
}


@pytest.mark.parametrize("door", ["gof", "add-on"])
@pytest.mark.parametrize("name", FTGS_SAYS)
def test_what_an_ftgs_ply_says_of_itself(tmp_path, door, name):
    """A clip of 1 s (11 frames, 0.1 s apart) in which it moves 3 m a clip."""
    from gof.io.importers import ImportOptions, read_result
    from gof_blender.pure.io.cloud import CloudTiming, load

    said, expected = FTGS_SAYS[name]
    comments = dict(line.split() for line in [*FTGS.split("|"), *filter(None, said.split("|"))])
    head = "".join(f"comment {key} {value}\n" for key, value in comments.items())
    head += f"element vertex 1\n{_properties(FTGS_NAMES)}end_header\n"
    data = f"ply\nformat binary_little_endian 1.0\n{head}".encode()
    path = tmp_path / "a.ftgs.ply"
    path.write_bytes(data + np.array([*ROW, 0.5, -1, 3, 0, 0], "<f4").tobytes())

    def speed() -> float:
        if door == "gof":
            return read_result(path, ImportOptions(frame_time_s=0.1)).gaussians.velocity[0, 0]
        return load(path, CloudTiming(fps=10)).velocity[0, 0]

    if isinstance(expected, float):
        assert speed() == pytest.approx(expected)
    else:
        with pytest.raises((DataFormatError, AddOnError), match=expected):
            speed()


def test_a_trajectory_with_a_misspelt_field_is_refused(tmp_path):
    """`velocities` was left aside, and differences of the positions were scored in its place."""
    from gof.io.importers import read_result

    states = {"position": np.zeros((2, 3, 3)), "opacity": np.ones((2, 3)), "scale": np.ones((3, 3))}
    states |= {"rotation": np.tile([1.0, 0, 0, 0], (3, 1)), "time_s": [0, 1], "velocities": np.ones((2, 3, 3))}
    np.savez(tmp_path / "mine.npz", schema="gof-trajectory/1", **states)
    with pytest.raises(DataFormatError, match=r"mine\.npz: \['velocities'\] are no fields"):
        read_result(tmp_path / "mine.npz")


@pytest.mark.parametrize("door", ["gof", "add-on"])
@pytest.mark.parametrize(
    "suffix, spoil, words",
    [
        (".npz", lambda fields: fields | {"gas_velocity": fields["v"]}, "'gas_velocity'"),
        (".npz", lambda fields: fields | {"sh": np.zeros((3, 1, 3), "f4")}, "'rgb', 'sh'"),
        (".ply", lambda names: [*names, "gas_vx", "gas_vy"], "gas_vz"),
        (".ply", lambda names: [*names, "v_gas_x"], "v_gas_x"),
    ],
)
def test_fields_of_results_that_nobody_reads_are_refused(tmp_path, door, suffix, spoil, words):
    """A misspelt gas velocity: the light's was scored in its place."""
    from gof.io.importers import read_result
    from gof_blender.pure.io.cloud import load
    from tests.conftest import random_gaussians
    from tests.plys import read_ply, write_ply

    path = random_gaussians(3).save(tmp_path / f"result{suffix}")
    if suffix == ".npz":
        with np.load(path) as data:
            fields = dict(data)
        np.savez(path, **spoil(fields))
    else:
        vertex, comments = read_ply(path)
        names = spoil(list(vertex.dtype.names))
        wide = np.zeros(3, [(name, vertex.dtype[name] if name in vertex.dtype.names else "f4") for name in names])
        for name in vertex.dtype.names:
            wide[name] = vertex[name]
        write_ply(path, wide, comments=comments)
    with pytest.raises((DataFormatError, AddOnError), match=rf"result{re.escape(suffix)}.*{words}"):
        (read_result if door == "gof" else load)(path)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"dimension_names": ["time", "x", "y", "z", "component"]}, None),
        ({"dimension_names": [None] * 5}, None),
        ({"dimension_names": ["time", "z", "y", "x", "component"]}, "axes"),
        ({"dimension_names": ["t", "x", "y", "z", "c"]}, "axes"),
        ({"frame": "camera"}, "frame 'camera'"),
    ],
)
def test_axes_and_frame_of_a_velocity_store(tmp_path, change, words):
    from gof.core.fields import VelocityField, VelocitySequence

    VelocitySequence.create(tmp_path / "v.zarr", [VelocityField(np.ones((2, 2, 2, 3)), np.eye(4), 0.0)])
    file = tmp_path / "v.zarr/zarr.json"
    content = json.loads(file.read_text())
    (content["attributes"] if "frame" in change else content).update(change)
    file.write_text(json.dumps(content))
    if words is None:
        VelocitySequence.open(tmp_path / "v.zarr")
    else:
        with pytest.raises(DataFormatError, match=rf"v\.zarr.*{words}"):
            VelocitySequence.open(tmp_path / "v.zarr")


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"distorsion": [0.1, 0, 0, 0]}, r"cameras\[0\]\.distorsion"),
        ({"model": "fisheye"}, r"cameras\[0\]\.model"),
        ({"K": [[90, 5, 50], [0, 90, 40], [0, 0, 1]]}, "skew"),
        ({"K": [[90, 0, 0], [0, 90, 0], [50, 40, 1]]}, "transposed"),
    ],
)
def test_what_cameras_by_hand_say_besides(tmp_path, changes, words):
    from gof.footage.lens import read_cameras as read_lenses

    camera = {"width": 100, "height": 80, "K": [[90, 0, 50], [0, 90, 40], [0, 0, 1]]}
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": [camera | changes]}))
    with pytest.raises(DataFormatError, match=rf"cameras\.json.*{words}"):
        read_lenses(tmp_path / "cameras.json", [tmp_path / "a.mp4"])


# ---------------------------------------------------------------- alignment


def _rig(names: str = "abcd", turn: np.ndarray | None = None, shift: float = 0.0) -> dict[str, np.ndarray]:
    """Cameras on a square of 4 m that look along +z; `shift`: of the first, along x."""
    poses = {}
    for name, (x, y) in zip(names, ((0, 0), (4, 0), (4, 4), (0, 4)), strict=True):
        camera_to_world = np.eye(4)
        camera_to_world[:3, 3] = (x + shift * (name == names[0]), y, 0)
        poses[name] = np.linalg.inv(camera_to_world if turn is None else camera_to_world @ turn)
    return poses


def test_an_alignment_says_what_it_leaves():
    """One of four cameras 0.6 m off its place in a rig 5.7 m across: the best fit leaves about half of that (rms)."""
    from gof.io.importers.alignment import align_cameras

    assert "that is much" not in align_cameras(_rig(), _rig()).in_words(Path("x.json"))
    found = align_cameras(_rig(shift=0.6), _rig())
    assert 0.12 < found.position_rms_m < 0.3
    assert "that is much for cameras 5.7 m apart" in found.in_words(Path("x.json"))


@pytest.mark.parametrize(
    "source",
    [_rig("acbd"), _rig(turn=np.diag([1.0, -1, -1, 1])), _rig("badc")],
    ids=["swapped", "OpenGL", "mirrored"],
)
def test_another_rig_is_refused(source):
    from gof.core.errors import GofError
    from gof.io.importers.alignment import align_cameras

    with pytest.raises(GofError, match="the best fit leaves"):
        align_cameras(source, _rig())
