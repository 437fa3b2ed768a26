"""Imports go one way, so that each room can be used, and understood, without those above it."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# What a part may import of ours: the parts named here (and itself).
BELOW = {
    "blender_addon": set(),
    "gof.render": {"gof"},
    "gof.io": {"gof", "gof.render"},
    "gof.evaluate": {"gof", "gof.render", "gof.io"},
    "gof.capture": {"gof", "gof.io"},
    "gof.reconstruct": {"gof", "gof.render", "gof.io", "gof.evaluate", "gof.capture"},
    "gof.report": {"gof", "gof.render", "gof.io", "gof.evaluate"},
    "gof": {"gof.io", "gof.render", "gof.evaluate"},
    "benchmark": {
        "blender_addon",
        "gof",
        "gof.render",
        "gof.io",
        "gof.evaluate",
        "gof.capture",
        "gof.reconstruct",
        "gof.report",
    },
}
BASE = {
    "errors",
    "cameras",
    "gaussians",
    "fields",
    "dataset",
    "stages",
    "lens",
    "plates",
    "__init__",
}  # of gof: below every part


def part_of(module: str) -> str:
    """The part of ours that a dotted module name belongs to, "" for other people's."""
    names = module.split(".")
    if names[0] not in ("gof", "benchmark", "blender_addon"):
        return ""
    return ".".join(names[:2]) if names[0] == "gof" and ".".join(names[:2]) in BELOW else names[0]


def imports(path: Path):
    """(module, line) of every import of ours in a file, also inside functions."""
    package = path.relative_to(ROOT).with_suffix("").parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level]) if node.level else ""
            yield ".".join(x for x in (base, node.module) if x), node.lineno


@pytest.mark.parametrize("part", BELOW)
def test_imports_go_one_way(part):
    files = [
        f
        for f in (ROOT / part.replace(".", "/")).rglob("*.py")
        if part_of(".".join(f.relative_to(ROOT).with_suffix("").parts)) == part
    ]
    assert files
    wrong = []
    for file in files:
        for module, line in imports(file):
            other = part_of(module)
            if other and other != part and other not in BELOW[part]:
                wrong.append(f"{file.relative_to(ROOT)}:{line} imports {module}")
    assert not wrong, "\n".join(wrong)


def test_the_base_needs_no_part_above_it():
    allowed = {"gof", "gof.io"}  # gof.io.files: reading and writing safely
    wrong = [
        f"gof/{name}.py:{line} imports {module}"
        for name in BASE
        for module, line in imports(ROOT / "gof" / f"{name}.py")
        if part_of(module) not in allowed | {""}
    ]
    assert not wrong, "\n".join(wrong)


def test_the_add_on_needs_numpy_and_blender_only():
    blenders_own = {
        "bpy",
        "mathutils",
        "bl_ui",
        "addon_utils",
        "bpy_extras",
        "manta",
        "_cycles",
        "OpenImageIO",
        "openvdb",
        "pyopenvdb",
    }
    allowed = set(sys.stdlib_module_names) | blenders_own | {"numpy", "blender_addon"}
    wrong = [
        f"{file.relative_to(ROOT)}:{line} imports {module}"
        for file in (ROOT / "blender_addon").rglob("*.py")
        for module, line in imports(file)
        if module.split(".")[0] not in allowed | {""}
    ]
    assert not wrong, "\n".join(wrong)
