"""Who imports whom: files and rooms as graphs, for tests/test_structure.py and docs/imports.mmd.

python tools/import_graph.py          print the diagram of docs/imports.mmd, which a code host draws
python tools/import_graph.py --write  write it there
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = {"gof": "gof", "gof_benchmark": "benchmark", "gof_blender": "blender_addon"}  # as in setup.py
# A file that starts a program belongs to the room that it opens, wherever the file has to stand.
ENTRANCES = {"gof.commands.cli": "gof/commands", "gof.__main__": "gof/commands", "gof_blender": "blender_addon/ui"}
ENTRANCES |= {"gof_blender.core": "gof/core"}
CORE = ("gof_blender.core.", "gof.core.")  # the same files under two names (setup.py)
PAGE = ROOT / "docs" / "architecture.md"
DIAGRAM = ROOT / "docs" / "imports.mmd"


def modules() -> dict[str, Path]:
    """Return every module of ours by its dotted import name."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            inner = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join([package, *(inner[:-1] if inner[-1] == "__init__" else inner)])] = path
    return found


def all_imports(name: str, path: Path, for_types: bool = False) -> Iterator[tuple[str, int]]:
    """Yield (dotted name, line) of all that a file imports, also inside functions; `for_types`: also for type checkers
    only.

    `from a import b` gives `a.b`, whether b is a module or not.
    """
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    tree = _parsed(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree) if for_types else _executed(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((f"{source}.{alias.name}", node.lineno) for alias in node.names)


@cache
def _parsed(text: str) -> ast.Module:
    """Return a file's tree, kept: a graph asks for every file, and there are several graphs."""
    return ast.parse(text)


def imports_of(name: str, path: Path, known: dict[str, Path], for_types: bool = False) -> Iterator[tuple[str, int]]:
    """Yield (module of ours, line) of a file's imports; `for_types` as in `all_imports`."""
    for target, line in all_imports(name, path, for_types):
        target = target.replace(*CORE) if target.startswith(CORE[0]) else target
        module = target if target in known else target.rpartition(".")[0]
        if module in known:
            yield module, line


def _executed(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a tree without the bodies of `if TYPE_CHECKING:`."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and getattr(node.test, "id", None) == "TYPE_CHECKING":
            continue
        yield node
        yield from _executed(node)


def file_graph(for_types: bool = False) -> dict[str, set[str]]:
    """Return module -> modules of ours that it imports; `for_types` as in `all_imports`."""
    known = modules()
    return {
        name: {target for target, _ in imports_of(name, path, known, for_types)} - {name}
        for name, path in known.items()
    }


def room_of(module: str, path: Path) -> str:
    """Return the room of a module: its folder, as in the repository; gof's own files are the room "gof"."""
    if module in ENTRANCES:
        return ENTRANCES[module]
    names = module.split(".")
    inner = names[1:] if path.name == "__init__.py" else names[1:-1]
    return "/".join([FOLDERS[names[0]], *inner[:1]])


def room_graph() -> dict[str, set[str]]:
    """Room -> rooms that it imports from."""
    rooms = {name: room_of(name, path) for name, path in modules().items()}
    graph: dict[str, set[str]] = {room: set() for room in rooms.values()}
    for name, targets in file_graph().items():
        graph[rooms[name]] |= {rooms[target] for target in targets} - {rooms[name]}
    return graph


def diagram() -> str:
    """Return the rooms as a Mermaid flowchart. An arrow that a longer way round implies is left out."""
    graph = room_graph()
    lines = ["flowchart TD"]
    for folder in FOLDERS.values():
        lines.append(f"  subgraph {folder}")
        lines += [f'    {_key(room)}["{room}"]' for room in sorted(graph) if room.split("/")[0] == folder]
        lines.append("  end")
    for room in sorted(graph):
        implied = {far for near in graph[room] for far in _reachable(graph, near)}
        lines += [f"  {_key(room)} --> {_key(other)}" for other in sorted(graph[room] - implied)]
    return "\n".join(lines) + "\n"


def _reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    found: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        room = waiting.pop()
        if room not in found:
            found.add(room)
            waiting += graph[room]
    return found


def _key(room: str) -> str:
    return room.replace("/", "_")


def main() -> int:
    if "--write" in sys.argv[1:]:
        DIAGRAM.write_text(diagram(), encoding="utf-8")
    else:
        print(diagram(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
