"""The house has an order: rooms and files import downwards only, and what must not be imported is not."""

import ast
import re
import sys
import textwrap
from functools import partial
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tools import import_graph
from tools.import_graph import FOLDERS, file_graph, imports_of, modules, room_graph

# Never imported by the part named: other people's libraries, and rooms of ours, by the start of their import names.
FORBIDDEN = {
    "gof": ("bpy", "gof_blender", "gof_benchmark"),
    "gof_blender": ("gof", "gof_benchmark", "torch", "mitsuba", "drjit", "zarr"),
    "gof_blender.pure": ("bpy", "mathutils", "gof_blender.scene", "gof_blender.ui", "gof_blender.worker"),
    "gof_benchmark.generator": ("gof_benchmark.studies",),
}
# Of the repository alone: what proves claims, and how the flow prior was learned.
NOT_INSTALLED = ("gof_benchmark.evidence", "gof_benchmark.training")
BLENDERS_OWN = {"bpy", "mathutils", "bl_ui", "addon_utils", "bpy_extras", "manta", "_cycles"}
BLENDERS_OWN |= {"OpenImageIO", "openvdb", "pxr", "pyopenvdb"}


@pytest.mark.parametrize(
    "graph", [file_graph, partial(file_graph, for_types=True), room_graph], ids=["files", "types", "rooms"]
)
def test_no_circle_of_imports(graph):
    try:
        TopologicalSorter(graph()).prepare()
    except CycleError as e:
        pytest.fail("imports go round: " + " <- ".join(e.args[1]))


def test_a_circle_is_found(tmp_path, monkeypatch):
    """The graph sees imports of every form, also inside functions, and not those for type checkers."""
    (tmp_path / "gof" / "room").mkdir(parents=True)
    (tmp_path / "gof" / "__init__.py").write_text("")
    (tmp_path / "gof" / "a.py").write_text("def f():\n    from gof.room import b\n")
    (tmp_path / "gof" / "room" / "__init__.py").write_text("")
    (tmp_path / "gof" / "room" / "b.py").write_text("if TYPE_CHECKING:\n    from gof import c\nfrom ..a import f\n")
    (tmp_path / "gof" / "c.py").write_text("import gof.a\n")
    monkeypatch.setattr(import_graph, "ROOT", tmp_path)
    monkeypatch.setattr(import_graph, "FOLDERS", {"gof": "gof"})
    graph = file_graph()
    assert graph["gof.a"] == {"gof.room.b"} and graph["gof.room.b"] == {"gof.a"} and graph["gof.c"] == {"gof.a"}
    with pytest.raises(CycleError):
        TopologicalSorter(graph).prepare()
    assert file_graph(for_types=True)["gof.room.b"] == {"gof.a", "gof.c"}


@pytest.mark.parametrize("part", FORBIDDEN)
def test_what_must_not_be_imported(part):
    known = modules()
    mine = {name: path for name, path in known.items() if name == part or name.startswith(f"{part}.")}
    assert mine
    wrong = [
        f"{path.relative_to(import_graph.ROOT)}:{line} imports {target}"
        for name, path in mine.items()
        for target, line in import_graph.all_imports(name, path)
        if any(target == bad or target.startswith(f"{bad}.") for bad in FORBIDDEN[part])
    ]
    assert not wrong, "\n".join(wrong)


def test_product_and_tests_import_no_evidence_and_the_product_no_tests():
    """Also not in code that they hand to another Python as text."""
    product = {name: path for name, path in modules().items() if not name.startswith(NOT_INSTALLED)}
    evidence = set(modules().values()) - set(product.values())
    never = re.compile(r"^\s*(?:from|import) gof_benchmark(?:\.| import )(?:evidence|training)\b", re.MULTILINE)
    tests = re.compile(r"^\s*(?:from|import) tests\b", re.MULTILINE)
    assert [path for path in evidence if never.search(path.read_text(encoding="utf-8"))], "it can be found"
    files = [*product.values(), *(import_graph.ROOT / "tests").rglob("*.py")]
    assert not [path for path in files if never.search(path.read_text(encoding="utf-8"))]
    assert not [path for path in product.values() if tests.search(path.read_text(encoding="utf-8"))]


def test_the_add_on_needs_numpy_and_blender_only():
    allowed = set(sys.stdlib_module_names) | BLENDERS_OWN | {"numpy", "gof_blender"}
    wrong = [
        f"{path.relative_to(import_graph.ROOT)}:{line} imports {target}"
        for name, path in modules().items()
        if name.split(".")[0] == "gof_blender"
        for target, line in import_graph.all_imports(name, path)
        if target.split(".")[0] not in allowed
    ]
    assert not wrong, "\n".join(wrong)


ROOM = "gof.look"  # the one that knows HTML and charts
DRAWS = {"matplotlib": "gof.look.drawing", "jinja2": "gof.look.pages"}  # in that room one file alone imports each
PAGES = re.compile(r"<html|<!doctype|<script", re.I)


def draws(known):
    """What of these modules draws charts or writes pages outside their place.

    Evidence may, and the add-on has a page of its own, because it must install without gof.
    """
    for name, path in known.items():
        if name.startswith(("gof_benchmark.evidence", "gof_blender")):
            continue
        for target, line in import_graph.all_imports(name, path):
            library = target.split(".")[0]
            if library in ("plotly", "viser") or DRAWS.get(library, name) != name:
                yield f"{path.name}:{line} imports {library}"
        if name != ROOM and not name.startswith(f"{ROOM}.") and PAGES.search(path.read_text(encoding="utf-8")):
            yield f"{path.name} writes HTML"


def test_one_room_knows_html_and_charts():
    wrong = list(draws(modules()))
    assert not wrong, "\n".join(wrong)


def test_a_chart_or_a_page_in_another_room_is_found(tmp_path):
    (tmp_path / "a.py").write_text("def f():\n    from matplotlib.figure import Figure\n")
    (tmp_path / "b.py").write_text("PAGE = '<!DOCTYPE html>'\n")
    outside = {f"gof.evaluate.{name}": tmp_path / f"{name}.py" for name in "ab"}
    assert list(draws(outside)) == ["a.py:2 imports matplotlib", "b.py writes HTML"]
    inside = {f"gof.look.{name}": tmp_path / f"{name}.py" for name in "ab"}
    assert list(draws(inside)) == ["a.py:2 imports matplotlib"]


def test_the_diagram_is_true():
    kept = import_graph.DIAGRAM.read_text(encoding="utf-8")
    assert import_graph.diagram() == kept, "docs/imports.mmd is old: run python tools/import_graph.py --write"


def test_the_table_of_rooms_is_whole():
    page = import_graph.PAGE.read_text(encoding="utf-8")
    missing = [room for room in room_graph() if f"`{room}`" not in page]
    assert not missing, f"docs/architecture.md does not say what is in {missing}"


def test_every_folder_is_a_part_of_ours():
    assert all((import_graph.ROOT / folder).is_dir() for folder in FOLDERS.values())
    assert any(list(imports_of(name, path, modules())) for name, path in modules().items())


def test_a_script_runs_when_all_of_it_is_defined():
    """The guard of a module that is run stands last: what follows it is not there yet when it runs."""
    root, guards = Path(__file__).parents[1], {}
    for room in ("gof", "benchmark", "blender_addon", "tools"):
        for path in (root / room).rglob("*.py"):
            body = ast.parse(path.read_text(encoding="utf-8")).body
            for place, node in enumerate(body, 1):
                if isinstance(node, ast.If) and "__name__" in ast.unparse(node.test):
                    guards[path.relative_to(root).as_posix()] = len(body) - place
    assert len(guards) > 40 and {path: left for path, left in guards.items() if left} == {}


ROOMS = ("gof", "benchmark", "blender_addon", "firmware", "tools")
MOST_LINES = {"function": 60, "module": 450}  # rules 10 and 11 of CONTRIBUTING.md; of a function without its docstring


def too_long(text: str) -> list[str]:
    """What of a module has more lines than its kind may have."""
    counts = {"module": ("module", len(text.splitlines()))}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0]
            docstring = 0 if ast.get_docstring(node) is None else first.end_lineno - first.lineno + 1
            lines = node.end_lineno - node.lineno + 1 - docstring
            counts[f"{node.name}, line {node.lineno}"] = "function", lines
    return [f"{name}: {count} lines" for name, (kind, count) in counts.items() if count > MOST_LINES[kind]]


def test_what_is_too_long_is_found():
    function = 'def f():\n    """Say.\n\n    More.\n    """\n' + "    x = 1\n\n" * 29 + "    x = 2\n"
    method = "class A:\n    @property\n" + textwrap.indent(function, "    ")
    assert too_long(function) == [] and too_long(method) == []
    assert too_long(function + "    x = 3\n") == ["f, line 1: 61 lines"]
    assert too_long(method + "        x = 3\n") == ["f, line 3: 61 lines"]
    assert too_long("x = 1\n" * 450) == [] and too_long("x = 1\n" * 451) == ["module: 451 lines"]


@pytest.mark.checkout
def test_functions_fit_on_a_screen_and_modules_hold_one_idea():
    root = Path(__file__).parents[1]
    files = [path for room in ROOMS for path in (root / room).rglob("*.py")]
    wrong = [f"{path.relative_to(root)}: {found}" for path in files for found in too_long(path.read_text("utf-8"))]
    assert len(files) > 400 and not wrong, "split them where an idea ends:\n" + "\n".join(wrong)
