"""A .blend from a stranger gives a scene its looks: no other file of this disk, no code, no place on this machine."""

import json
import re
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof_blender.pure.fires import GridFire
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import BlendFile, SceneSpec, SpecError, load, save
from tests.blender.runs import TOY, in_blender

SECRET = "TOPSECRET-0123456789"

MAKE = """
import bpy, sys, os
from pathlib import Path
folder = Path(sys.argv[1])
os.makedirs(folder / "room" / "textures")
os.makedirs(folder / "private")
(folder / "private" / "id_rsa").write_text("SECRET")
(folder / "room" / "key.png").write_text("SECRET")
def picture(path, colour):
    image = bpy.data.images.new("p", 4, 4)
    image.generated_color = colour
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
picture(folder / "room" / "textures" / "wood.png", (0.25, 0.5, 0.75, 1))
picture(folder / "private" / "diary.png", (1, 0, 0, 1))
(folder / "room" / "link.png").symlink_to(folder / "private" / "diary.png")
(folder / "private" / "clip.blend").write_bytes(b"")

def scene(name, image=None, font=None, library=None, act=False):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    here = bpy.context.scene
    marker = bpy.data.objects.new("Hearth", None)
    marker.location = (1, 2, 3)
    marker.hide_render = True
    here.collection.objects.link(marker)
    bpy.ops.mesh.primitive_plane_add(location=(1, 2, 4))
    wall = bpy.context.object
    wall.name = "Wall"
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    wall.data.materials.append(material)
    tree = material.node_tree
    if image:
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.new("Texture", 4, 4)
        node.image.source = "FILE"
        node.image.filepath = image
        tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    if font:
        curve = bpy.data.curves.new("Sign", "FONT")
        curve.font = bpy.data.fonts.load(font)
        here.collection.objects.link(bpy.data.objects.new("Sign", curve))
    if library:
        with bpy.data.libraries.load(library, link=True) as (theirs, ours):
            ours.objects = ["Wall"]
        here.collection.objects.link(ours.objects[0])
    if act:
        driver = tree.driver_add('nodes["Principled BSDF"].inputs[2].default_value').driver
        driver.expression = "__import__('os').system('touch " + str(folder / "RAN") + "') or 0.5"
        text = bpy.data.texts.new("evil.py")
        text.from_string("import os; os.system('touch " + str(folder / "RAN") + "') # SECRET")
        text.use_module = True
        tree.nodes.new("ShaderNodeScript").script = text
        wall["author"] = "kept"
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room" / name), relative_remap=False)

scene("good.blend", image="//textures/wood.png", act=True)
scene("outside.blend", image="//../private/diary.png")
scene("absolute.blend", image=str(folder / "private" / "id_rsa"))
scene("notpicture.blend", image="//key.png")
scene("linked.blend", image="//link.png")
scene("missing.blend", image="//nowhere/gone.png")
fonts = Path(bpy.utils.system_resource("DATAFILES")) / "fonts"
font = next(iter(sorted(p for p in fonts.iterdir() if p.suffix in (".ttf", ".woff2", ".otf"))))
(folder / "private" / font.name).write_bytes(font.read_bytes())
scene("font.blend", font=str(folder / "private" / font.name))
scene("library.blend", library=str(folder / "room" / "missing.blend"))
os._exit(0)
""".replace("SECRET", SECRET)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("foreign")
    made = subprocess.run([sys.executable, "-c", MAKE, str(folder)], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr[-2000:]
    return folder


@pytest.fixture(scope="module")
def built(foreign) -> dict:
    """Every file built as a background in one Blender: what was said, and what the good one left in the scene."""
    return in_blender(
        """
        from dataclasses import replace
        from pathlib import Path
        from gof_blender.pure.spec import BlendFile, SceneSpec
        from gof_blender.scene import build
        from gof_blender.scene.backgrounds import blend_file
        from gof_blender.worker import generate
        from gof_blender.pure.layout import Layout
        toy = SceneSpec("toy").with_preset("toy")
        folder = Path(sys.argv[1])
        for path in sorted((folder / "room").glob("*.blend")):
            background = BlendFile(str(path), "Hearth")
            try:
                build.scene(replace(toy, background="blend_file", blend_file=background))
                result[path.stem] = ""
            except Exception as error:
                result[path.stem] = f"{type(error).__name__}: {error}"
            if path.stem == "good":
                result["texts"] = len(bpy.data.texts)
                result["drivers"] = sum(
                    len(t.animation_data.drivers) for t in (m.node_tree for m in bpy.data.materials) if t.animation_data
                )
                image = bpy.data.images["Texture"]
                result["pixel"] = list(image.pixels[:4])
                result["packed"] = len(image.packed_files)
                layout = Layout(folder / "data")
                layout.root.mkdir()
                blend_file.save(bpy.data.collections["Background"], layout.background)
                generate._save_blend(layout)
        again = replace(toy, background="blend_file", blend_file=BlendFile(str(layout.background), "Hearth"))
        build.scene(again)
        result["wall"] = list(bpy.data.objects["Wall"].matrix_world.translation)
        result["pixel again"] = list(bpy.data.images["Texture"].pixels[:4])
        """,
        foreign,
    )


@pytest.mark.blender
def test_only_pictures_beside_the_file_come_in(built, foreign):
    assert built["good"] == "" and built["missing"] == ""
    assert built["packed"] == 1
    np.testing.assert_allclose(built["pixel"], [0.25, 0.5, 0.75, 1], atol=0.01)
    for name, words in {
        "outside": "diary.png, which is not in",
        "absolute": "id_rsa, which is not in",
        "linked": "diary.png, which is not in",
        "notpicture": "key.png, which is no picture",
        "font": "which is no picture",
        "library": "links .*missing.blend, another .blend",
    }.items():
        assert built[name].startswith("SpecError: blend_file.path"), (name, built[name])
        assert re.search(words, built[name]), (name, built[name])


@pytest.mark.blender
def test_nothing_runs_and_nothing_that_could_stays(built, foreign):
    assert not (foreign / "RAN").exists()
    assert built["texts"] == 0 and built["drivers"] == 0


@pytest.mark.blender
def test_no_place_on_this_machine_is_in_the_files(built, foreign):
    for name in ("scene.blend", "background.blend"):
        content = unpacked(foreign / "data" / name)
        for word in (str(foreign), str(Path.home()), SECRET, "evil.py"):
            assert word.encode() not in content, (name, word)
        assert b"wood.png" in content and b"kept" in content, "it is the right file, unpacked"


@pytest.mark.blender
def test_the_surroundings_come_back_from_the_datasets_own_copy(built):
    np.testing.assert_allclose(built["wall"], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(built["pixel again"], [0.25, 0.5, 0.75, 1], atol=0.01)


def unpacked(path: Path) -> bytes:
    """The content of a .blend, also of one that is compressed (zstd, in frames of its own)."""
    data = path.read_bytes()
    if data[:4] != b"\x28\xb5\x2f\xfd":
        return zlib.decompress(data, 31) if data[:2] == b"\x1f\x8b" else data
    import zstandard

    with open(path, "rb") as file:
        return zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True).read()


# ---------------------------------------------------------------- specs


def test_a_published_spec_names_no_place(tmp_path):
    home, disk = Path("/home/alice/rooms"), Path("/scratch/out")
    spec = replace(TOY, background="blend_file", blend_file=BlendFile(str(home / "room.blend"), "Hearth"))
    published = spec.published_in(disk / "d")
    assert published.blend_file.path == "background.blend" and "alice" not in json.dumps(published.to_dict())
    fire = replace(TOY, domain=None, fire=GridFire(str(home / "puff")))
    assert fire.published_in(disk / "d").fire.grids == "puff"
    assert fire.published_in(Path("/home/alice/data/d")).fire.grids == "../../rooms/puff"
    assert fire.published_in(home).fire.grids == "puff"
    assert TOY.published_in(disk) == TOY


def test_a_dataset_belongs_to_the_files_of_its_spec(tmp_path):
    """Claimed again with another .blend, or one that has changed: refused, not yesterday's pictures."""
    room, other = tmp_path / "room.blend", tmp_path / "other.blend"
    room.write_bytes(b"one")
    other.write_bytes(b"another")
    layout = Layout(tmp_path / "d")
    spec = replace(TOY, background="blend_file", blend_file=BlendFile(str(room), "Hearth"))
    layout.claim(spec)
    layout.claim(spec)
    assert load(layout.local_spec) == spec
    assert str(tmp_path) not in layout.spec.read_text()
    with pytest.raises(SpecError, match=r"other\.blend, which has changed"):
        layout.claim(replace(spec, blend_file=BlendFile(str(other), "Hearth")))
    with pytest.raises(SpecError, match="another spec"):
        layout.claim(replace(spec, blend_file=BlendFile(str(room), "Elsewhere")))
    room.write_bytes(b"two!")
    with pytest.raises(SpecError, match=r"room\.blend, which has changed"):
        layout.claim(spec)


def test_an_older_folder_is_still_its_specs(tmp_path):
    """spec.json held absolute paths, and nothing was noted of the files."""
    (tmp_path / "room.blend").write_bytes(b"one")
    spec = replace(TOY, background="blend_file", blend_file=BlendFile(str(tmp_path / "room.blend"), "Hearth"))
    layout = Layout(tmp_path / "d")
    layout.root.mkdir()
    save(spec, layout.spec)
    layout.claim(spec)
    assert isinstance(load(layout.local_spec), SceneSpec)
