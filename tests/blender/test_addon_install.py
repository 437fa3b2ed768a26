"""The built zip: one version, the same bytes, nothing stray; installed into a fresh Blender, new and old."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import gof
from tools import build_addon

INSTALL = """
import bpy, sys
def state():
    return sorted(name for name in dir(bpy.types) if name.startswith("GOF_")), hasattr(bpy.types.Scene, "gof")
zip_path = ZIP
print("Blender", bpy.app.version_string)
assert state() == ([], False), state()
if hasattr(bpy.ops, "extensions") and bpy.app.version >= (4, 2):
    name = "bl_ext.user_default.gaussians_on_fire"
    options = {"repo": "user_default", "enable_on_install": True}
    print("install:", bpy.ops.extensions.package_install_files(filepath=zip_path, **options))
else:
    name = "gaussians_on_fire"
    print("install:", bpy.ops.preferences.addon_install(filepath=zip_path))
    print("enable:", bpy.ops.preferences.addon_enable(module=name))
first, has_settings = state()
assert has_settings and len(first) >= 4, first
print("enabled:", name, "with", len(first), "classes")
for _ in range(2):
    print("disable:", bpy.ops.preferences.addon_disable(module=name))
    assert state() == ([], False), state()
    print("enable:", bpy.ops.preferences.addon_enable(module=name))
    assert state() == (first, True), state()
for panel in (getattr(bpy.types, name) for name in first if "_PT_" in name):
    assert panel.bl_category == "Gaussians on Fire", panel
preferences = bpy.context.preferences.addons[name].preferences
preferences.python = "/somewhere/python"
assert sys.modules[name + ".ui.preferences"].python() == "/somewhere/python"
assert bpy.ops.gof.documentation() == {"FINISHED"}
assert bpy.data.texts["documentation.md"].lines[0].body == "# The Blender add-on"
assert {"fire", "benchmark", "reconstruction", "score"} <= set(bpy.context.scene.gof.bl_rna.properties.keys())
print("INSTALLED")
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    return build_addon.build(tmp_path_factory.mktemp("addon"))


def run(command: list[str], user: Path) -> str:
    """A Blender with an empty user folder; returns what it printed, which is the install log."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("BLENDER_")}
    done = subprocess.run(
        command, env=environment | {"BLENDER_USER_RESOURCES": str(user)}, capture_output=True, text=True
    )
    print(done.stdout, done.stderr)
    assert "INSTALLED" in done.stdout
    assert "Traceback" not in done.stderr and "Warning" not in done.stdout
    return done.stdout


def test_versions_agree_and_a_wrong_one_is_named(monkeypatch):
    assert build_addon.version() == gof.__version__
    real = build_addon.constant
    monkeypatch.setattr(
        build_addon, "constant", lambda path, name: "9.9.9" if name == "__version__" else real(path, name)
    )
    with pytest.raises(SystemExit, match=r"blender_manifest\.toml: version is .*, gof\.__version__ is 9\.9\.9"):
        build_addon.version()


def test_zip_holds_the_sources_and_nothing_else_and_is_reproducible(built, tmp_path):
    with zipfile.ZipFile(built) as archive:
        names = archive.namelist()
    assert names == sorted(names) and {name.split("/")[0] for name in names} == {build_addon.NAME}
    assert {Path(name).suffix for name in names} == {".py", ".toml", ".md", ""} and not any(
        "__pycache__" in name for name in names
    )
    assert {
        "gaussians_on_fire/__init__.py",
        "gaussians_on_fire/blender_manifest.toml",
        "gaussians_on_fire/LICENSE",
        "gaussians_on_fire/documentation.md",
    } <= set(names)
    assert build_addon.build(tmp_path).read_bytes() == built.read_bytes()


def test_stray_file_is_refused(tmp_path, monkeypatch):
    (tmp_path / "notes.txt").write_text("")
    monkeypatch.setattr(build_addon, "SOURCE", tmp_path)
    with pytest.raises(SystemExit, match=r"notes\.txt is no file of the add-on"):
        build_addon.files()


def test_only_numpy_and_blender_are_imported(built):
    """What the sources import: the standard library, numpy, and what every Blender has."""
    import ast

    known = {
        *sys.stdlib_module_names,
        "numpy",
        "bpy",
        "bpy_extras",
        "mathutils",
        "gpu",
        "gpu_extras",
        "bl_math",
        "OpenImageIO",
        "openvdb",
        "pyopenvdb",
        "pxr",
        "_cycles",
    }
    late = {"psutil", "zstandard"}  # in gof/core, for what the add-on does without
    for path in build_addon.files():
        if path.suffix != ".py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert {module.split(".")[0] for module in modules} <= known | (
                late if build_addon.CORE in path.parents else set()
            ), path


@pytest.mark.blender
def test_blenders_own_check_accepts_the_zip(built):
    bpy = pytest.importorskip("bpy", reason="the validator comes with Blender")
    scripts = Path(bpy.__file__).resolve().parents[2]
    check = (
        scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    )  # what `blender --command extension validate` runs
    done = subprocess.run([sys.executable, str(check), "validate", str(built)], capture_output=True, text=True)
    assert done.returncode == 0 and "Success" in done.stdout, done.stdout + done.stderr


@pytest.mark.blender
def test_installs_as_an_extension(built, tmp_path):
    pytest.importorskip("bpy", reason="needs the bpy wheel")
    script = INSTALL.replace("ZIP", repr(str(built)), 1)
    run([sys.executable, "-c", script], tmp_path)
    assert (tmp_path / "extensions" / "user_default" / "gaussians_on_fire" / "__init__.py").is_file()


@pytest.mark.blender
@pytest.mark.skipif(not shutil.which("blender"), reason="no Blender application on this machine")
def test_installs_into_the_blender_application(built, tmp_path):
    """Debian 12's is 3.4, which takes the zip as a legacy add-on."""
    script = INSTALL.replace("ZIP", repr(str(built)), 1)
    run(
        [shutil.which("blender"), "-b", "--factory-startup", "--python-exit-code", "1", "--python-expr", script],
        tmp_path,
    )
