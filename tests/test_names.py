"""Names: those in files are no paths, which would write, read or link outside their folder; a class has its own."""

import ast
import json
import os
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from gof.capture import annotate as annotate_module
from gof.capture.template import BoardTemplate
from gof.core.cameras import Camera
from gof.core.drafts import draft_of
from gof.core.errors import DataFormatError, GofError
from gof.core.files import is_name, path_in
from gof.dataset import Dataset
from gof.dataset.plates import background, save_plates
from gof.evaluate.depth import read_depth
from gof.look.report import Preview, _stage_pictures
from gof.reconstruct.captions import Caption, Captions
from gof_blender.core.checked_json import SpecError
from gof_blender.core.errors import DataFormatError as ErrorOfTheAddOn
from gof_blender.pure.spec import SceneSpec
from gof_blender.worker.import_result import read_spec
from tests.conftest import arc

# By hand, not by a rule: what no name may be, and what one may be.
HOSTILE = [
    "",
    ".",
    "..",
    "../x",
    "../../../TRAVERSED",
    "/etc/passwd",
    "a/b",
    "a\\b",
    "..\\x",
    "C:\\x",
    "C:x",
    "x:stream",
    "\\\\server\\share",
    "a\0b",
    "a\nb",
    "a\rb",
    "\x1b]0;owned\x07",
    "\x9b31m",
    "a\u202egnp.exe",
    "\ud800",
    "\udcff",
    "CON",
    "nul",
    "nul.png",
    "Com1",
    "lpt9.txt",
    "COM\u00b9",
    "trailing.",
    "trailing ",
    "-rf",
    "--overwrite",
    "~",
    "~root",
    "a*b",
    "a?b",
    "a|b",
    'a"b',
    "<b>",
    "{frame}",
    "x" * 201,
    "\u00fc" * 101,
]
GOOD = [
    "cam_0",
    "GoPro 13 (left)",
    "K\u00fcche",
    "\u5de6",
    "a.b",
    ".hidden",
    "con_1",
    "console",
    "x" * 200,
    "[bold]",
    "=1+1",
    "&",
]


def test_what_is_a_name():
    assert [name for name in HOSTILE if is_name(name)] == []
    assert [name for name in GOOD if not is_name(name)] == []


def test_paths_stay_in_their_folder(tmp_path):
    folder, outside = tmp_path / "d", tmp_path / "secret"
    for path in (folder / "sub", outside):
        path.mkdir(parents=True)
    (outside / "key").write_text("secret")
    (folder / "link").symlink_to(outside)
    (folder / "sub" / "key").symlink_to(outside / "key")
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "within").symlink_to(folder / "sub")
    assert path_in(folder, "sub/new.png") == folder / "sub" / "new.png"
    assert path_in(folder, "within/new.png").parent.resolve() == (folder / "sub").resolve()
    for name in [
        *HOSTILE,
        "sub/../../secret/key",
        "sub//x",
        "./x",
        "link/key",
        "sub/key",
        "loop",
        "loop/x",
        "a/" * 600,
    ]:
        if name == "a/b":
            continue  # a path of two names
        with pytest.raises(DataFormatError, match=r"^[^\n\0\x1b]*$"):  # and the message can be printed anywhere
            path_in(folder, name)


def test_a_pipe_is_no_file(tmp_path):
    """Whoever opens one to read waits for somebody who writes: a command without an end."""
    os.mkfifo(tmp_path / "000000.png")
    (tmp_path / "link.png").symlink_to(tmp_path / "000000.png")
    for name in ("000000.png", "link.png"):
        with pytest.raises(DataFormatError, match=rf"{name}.*a pipe or a device"):
            path_in(tmp_path, name)
    assert path_in(tmp_path, "absent.png") == tmp_path / "absent.png"


# ---------------------------------------------------------------- datasets


def edited(dataset: Path, change) -> Path:
    meta = json.loads((dataset / "dataset.json").read_text())
    change(meta)
    (dataset / "dataset.json").write_text(json.dumps(meta))
    return dataset


@pytest.mark.parametrize("name", ["../../../TRAVERSED", "/tmp/ABSOLUTE", "nul", "a\0b", "a\nb", "\udcff", "-x"])
def test_a_camera_has_a_name(tiny_dataset, name):
    """Cameras' names become the files of plates, masks and depths."""
    with pytest.raises(DataFormatError, match="name"):
        Camera(name, 8, 8, np.eye(3), np.eye(4))
    with pytest.raises(DataFormatError, match=r"dataset\.json.*(name|surrogates)"):
        Dataset.open(edited(tiny_dataset, lambda d: d["cameras"][0].update(name=name)))


def test_two_cameras_that_one_disk_would_store_as_one(tiny_dataset):
    with pytest.raises(DataFormatError, match="same name"):
        Dataset.open(edited(tiny_dataset, lambda d: d["cameras"][0].update(name="CAM_1")))


@pytest.mark.parametrize("kind", ["rgb", "static", "mask", "exr", "flow", "board_mask"])
def test_patterns_stay_in_the_dataset(tiny_dataset, kind):
    """All are refused when the dataset is opened: layouts for other programs write them down unread."""
    for name in ("../../secret.png", "/etc/passwd", "nul", "a\nb.png", "{frame:0999999999d}.png", "{other}.png"):
        with pytest.raises(DataFormatError, match=rf"dataset\.json.*cam_0.*{kind}"):
            Dataset.open(edited(tiny_dataset, lambda d, name=name: d["cameras"][0].update({kind: name})))


def test_velocity_is_a_name(tiny_dataset):
    for name in ("../other.zarr", "/other.zarr", "a\0b"):
        edited(tiny_dataset, lambda d, name=name: d.update(velocity=name))
        with pytest.raises(DataFormatError, match=r"dataset\.json.*velocity"):
            Dataset.open(tiny_dataset)


def test_plates_are_neither_written_nor_read_outside(tiny_dataset, tmp_path):
    plates = [np.zeros((8, 8, 3))] * 2
    out = tmp_path / "out"
    with pytest.raises(DataFormatError):
        save_plates(out, ["../../escaped", "cam_1"], plates)
    outside = tmp_path / "elsewhere"
    outside.mkdir()
    out.mkdir()
    (out / "plates").symlink_to(outside)  # of an unpacked archive, say
    with pytest.raises(DataFormatError, match="outside"):
        save_plates(out, ["cam_0", "cam_1"], plates)
    assert not list(outside.iterdir()) and not (tmp_path / "escaped.png").exists()
    (outside / "cam_0.png").write_bytes(b"secret")
    with pytest.raises(DataFormatError, match="outside"):
        background(Dataset.open(tiny_dataset), 0, out)


def test_board_masks_are_not_written_through_links(tiny_dataset, tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.mkdir()
    (tiny_dataset / "cameras" / "cam_0").rename(tmp_path / "moved")
    (tiny_dataset / "cameras" / "cam_0").symlink_to(victim)
    mask = np.full((64, 36), 255, np.uint8)
    monkeypatch.setattr(annotate_module, "find_mask", lambda pictures, template: mask)
    with pytest.raises(DataFormatError, match="outside"):
        annotate_module.annotate(Dataset.open(tiny_dataset), BoardTemplate.load("paper_rig"))
    assert not list(victim.iterdir())


def test_depth_maps_are_read_in_their_folder(tiny_dataset, tmp_path):
    np.save(tmp_path / "000000.npy", np.ones((4, 4)))
    (tmp_path / "d").mkdir()
    with pytest.raises(DataFormatError):
        read_depth(tmp_path / "d", "..", 0)


def test_views_are_not_written_through_links(tmp_path):
    """`gof generate --views` in a folder that a stranger has prepared."""
    from gof_benchmark.views import dynerf
    from gof_benchmark.views.source import ViewSource
    from tests.conftest import write_dataset

    root, victim = tmp_path / "d", tmp_path / "victim"
    images = np.zeros((1, 1, 64, 36, 3))
    write_dataset(root, arc(1), images, images[0], [0.0])
    victim.mkdir()
    (root / "dynerf").symlink_to(victim)
    source = ViewSource.open(root)
    with pytest.raises(DataFormatError, match="outside"):
        dynerf.link_pictures(source, 0, 0)
    assert not list(victim.iterdir())


def test_a_view_never_links_what_lies_outside(tmp_path):
    from gof_benchmark.views import dynerf
    from gof_benchmark.views.source import ViewSource
    from tests.conftest import write_dataset

    root, secret = tmp_path / "d", tmp_path / "id_rsa"
    images = np.zeros((1, 1, 64, 36, 3))
    write_dataset(root, arc(1), images, images[0], [0.0])
    secret.write_text("secret")
    picture = root / "cameras/cam_0/rgb/000000.png"
    picture.unlink()
    picture.symlink_to(secret)
    with pytest.raises(DataFormatError, match="outside"):
        dynerf.link_pictures(ViewSource.open(root), 0, 0)
    assert os.stat(secret).st_nlink == 1


def test_no_grid_is_read_from_a_pipe(tmp_path):
    from gof.core.fields import VelocityField, VelocitySequence

    field = VelocityField.from_array(np.ones((4, 4, 4, 3)), (0, 0, 0), 0.5, 0.0)
    VelocitySequence.create(tmp_path / "velocity.zarr", [field])
    chunk = next(p for p in (tmp_path / "velocity.zarr/c").rglob("*") if p.is_file())
    chunk.unlink()
    os.mkfifo(chunk)
    with pytest.raises(DataFormatError, match="a pipe or a device"):
        VelocitySequence.open(tmp_path / "velocity.zarr").frame(0)
    with pytest.raises(DataFormatError, match="a pipe or a device"):
        VelocitySequence.open(tmp_path / "velocity.zarr").sample(np.full((1, 3), 0.3), np.zeros(1))


# ---------------------------------------------------------------- reports


def test_a_preview_and_captions_name_pictures_beside_them(tmp_path):
    for name in ("../secret.png", "/etc/passwd", "a/b.png", "nul"):
        with pytest.raises(GofError, match="name"):
            Preview(name, 0, 0)
        with pytest.raises(GofError, match="name"):
            Caption(name, "text")
    (tmp_path / "captions.json").write_text(
        json.dumps({"schema": "gof-captions", "version": 1, "images": [{"file": "../../x.png", "text": "t"}]})
    )
    with pytest.raises(DataFormatError, match=r"captions\.json.*name"):
        Captions.read(tmp_path)


def test_a_caption_does_not_follow_a_link_out(tmp_path):
    import cv2

    (tmp_path / "stages").mkdir()
    cv2.imwrite(str(tmp_path / "private.png"), np.zeros((4, 4, 3), np.uint8))
    (tmp_path / "stages" / "1.png").symlink_to(tmp_path / "private.png")
    Captions((Caption("1.png", "text"),)).write(tmp_path / "stages")
    with pytest.raises(DataFormatError, match="outside"):
        _stage_pictures(tmp_path / "stages")


# ---------------------------------------------------------------- scenes


@pytest.mark.parametrize("name", ["..", ".", "a\n\0b", "../x", "nul", "x\x1b[2J"])
def test_a_scene_has_a_name(name):
    with pytest.raises(SpecError, match="name"):
        SceneSpec(name)


def test_the_scene_of_a_dataset_uses_files_of_the_dataset(tiny_dataset, tmp_path):
    """`gof import` opens what dataset.json names in Blender: only what lies in the dataset."""

    def with_background(path: str):
        spec = SceneSpec("x").to_dict() | {"background": "blend_file", "blend_file": {"path": path, "empty": "Fire"}}
        edited(tiny_dataset, lambda d: d.update(spec=spec))
        return read_spec(tiny_dataset)

    (tiny_dataset / "background.blend").write_bytes(b"")
    assert Path(with_background("background.blend").blend_file.path) == (tiny_dataset / "background.blend").resolve()
    (tmp_path / "private.blend").write_bytes(b"")
    for path in ("../private.blend", str(tmp_path / "private.blend"), "a\0b"):
        with pytest.raises(ErrorOfTheAddOn, match=r"dataset\.json"):
            with_background(path)


# ---------------------------------------------------------------- what is written beside a name


def test_a_draft_is_never_written_through_a_link(tmp_path):
    """A folder from somebody else may hold links where our temporary files go."""
    from gof.core import files

    victim = tmp_path / "victim"
    victim.write_text("precious")
    target = tmp_path / "d" / "dataset.json"
    target.parent.mkdir()
    draft_of(target).symlink_to(victim)
    files.write_json(target, {"a": 1})
    assert victim.read_text() == "precious" and not target.is_symlink()
    assert json.loads(target.read_text()) == {"a": 1}


def test_a_lock_is_never_written_through_a_link(tmp_path):
    from gof.core.files import only_run_in

    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / ".lock").symlink_to(victim)
    with pytest.raises(GofError, match=r"\.lock: is a link"), only_run_in(tmp_path / "d"):
        pass
    assert victim.read_text() == "precious"


# ---------------------------------------------------------------- classes

ROOMS = ("gof", "benchmark", "blender_addon", "firmware", "tools")
SHARED = {
    "Settings",  # of every effect, by the add-on's contract (blender_addon/pure/effects/__init__.py)
}


def classes_of_several(files: list[Path]) -> dict[str, list[Path]]:
    """Return names of classes, nested and private ones too, that two or more of these files define."""
    found = defaultdict(list)
    for path in files:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for name in {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}:
            found[name].append(path)
    return {name: paths for name, paths in found.items() if len(paths) > 1}


@pytest.mark.checkout
def test_a_class_has_a_name_of_its_own():
    root = Path(__file__).parents[1]
    files = [path for room in ROOMS for path in (root / room).rglob("*.py")]
    product = [path for path in files if "checks" not in path.relative_to(root).parts]  # those are tests
    found = classes_of_several(product)
    wrong = [f"{name}: {', '.join(map(str, paths))}" for name, paths in found.items() if name not in SHARED]
    assert not wrong, "give each its own name:\n" + "\n".join(wrong)
    assert found.keys() >= SHARED, "an exception that is none any more"


def test_a_name_of_two_classes_is_found(tmp_path):
    (tmp_path / "a.py").write_text("class Row:\n    pass\n\n\nclass Column:\n    pass\n")
    (tmp_path / "b.py").write_text("def f():\n    class Row:\n        pass\n")
    assert classes_of_several([tmp_path / "a.py", tmp_path / "b.py"]) == {"Row": [tmp_path / "a.py", tmp_path / "b.py"]}


# ---------------------------------------------------------------- functions


def raisers_of_other_names(text: str) -> list[str]:
    """Return functions that can only raise, named `check_` or `refuse_`: such are `require_` in the whole product."""
    functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef)]
    raising = [f for f in functions if isinstance(f.returns, ast.Constant) and f.returns.value is None]
    return [f.name for f in raising if f.name.lstrip("_").startswith(("check_", "refuse_"))]


@pytest.mark.checkout
def test_what_raises_on_bad_input_has_one_prefix():
    root = Path(__file__).parents[1]
    files = [path for room in ROOMS for path in (root / room).rglob("*.py")]
    found = {path.name: names for path in files if (names := raisers_of_other_names(path.read_text("utf-8")))}
    assert found == {}
    assert raisers_of_other_names("def _check_a() -> None: ...\ndef check_b() -> bool: ...") == ["_check_a"]


# ---------------------------------------------------------------- variables

VAGUE = {"here", "there", "told"}  # names that do not say what they hold


def vague_names(text: str) -> list[str]:
    """Return variables and parameters whose names say nothing."""
    nodes = list(ast.walk(ast.parse(text)))
    found = {(node.lineno, node.arg) for node in nodes if isinstance(node, ast.arg)}
    found |= {(n.lineno, n.id) for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return [f"{name}, line {line}" for line, name in sorted(found) if name in VAGUE]


@pytest.mark.checkout
def test_variables_say_what_they_hold():
    root = Path(__file__).parents[1]
    files = [path for room in ROOMS for path in (root / room).rglob("*.py")]
    product = [path for path in files if "checks" not in path.relative_to(root).parts]  # those are tests
    wrong = {path.relative_to(root): names for path in product if (names := vague_names(path.read_text("utf-8")))}
    assert len(product) > 400 and wrong == {}


def test_a_vague_name_is_found():
    assert vague_names("def f(told):\n    here, x = told, there\n") == ["told, line 1", "here, line 2"]
    assert vague_names("near_camera = lines[0].here\n") == []
