"""An option that nothing reads cannot exist: every field of every class given to `tyro.cli` or
`read_options` is read somewhere.

Read from the source, without running it: `NAME.field` of a name that is known to hold the options.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest

from tools.import_graph import modules


@cache
def walked(node: ast.AST) -> tuple[ast.AST, ...]:
    """The nodes of a tree, which is asked for once a class of options."""
    return tuple(ast.walk(node))


WHOLE = {"asdict", "vars", "astuple", "fields"}  # hand over every field at once


@dataclass
class Source:
    """Modules by name, parsed, and the classes of all of them by (module, name)."""

    trees: dict[str, ast.Module]
    classes: dict[tuple[str, str], ast.ClassDef] = field(default_factory=dict)
    imported: dict[str, dict[str, tuple[str, str]]] = field(default_factory=dict)
    known: dict[str, set[tuple[str, str] | None]] = field(default_factory=dict)  # the classes that a module may name

    def __post_init__(self):
        for module, tree in self.trees.items():
            for node in walked(tree):
                if isinstance(node, ast.ClassDef):
                    self.classes[module, node.name] = node
            self.imported[module] = {
                alias.asname or alias.name: (node.module, alias.name)
                for node in walked(tree)
                if isinstance(node, ast.ImportFrom) and node.module
                for alias in node.names
            }

        names = {
            module: self.imported[module].keys() | {n for m, n in self.classes if m == module} for module in self.trees
        }
        self.known = {module: {self.find(module, name) for name in names[module]} for module in self.trees}

    def find(self, module: str, name: str) -> tuple[str, str] | None:
        """The class that a name means in a module, followed through what packages hand on."""
        for _ in range(5):
            if (module, name) in self.classes:
                return module, name
            if name not in self.imported.get(module, {}):
                return None
            module, name = self.imported[module][name]
        return None

    def named_in(self, module: str, node: ast.AST | None) -> set[tuple[str, str]]:
        """The classes that an annotation, or any other code, names."""
        names = {part.id for part in walked(node) if isinstance(part, ast.Name)} if node is not None else set()
        return {found for name in names if (found := self.find(module, name))}

    def is_dataclass(self, key: tuple[str, str]) -> bool:
        return any("dataclass" in ast.unparse(each) for each in self.classes[key].decorator_list)

    def lineage(self, key: tuple[str, str]) -> list[tuple[str, str]]:
        """A class and those of ours that it is made from."""
        bases = [found for base in self.classes[key].bases for found in self.named_in(key[0], base)]
        return [key, *(older for base in bases for older in self.lineage(base))]

    def options(self, key: tuple[str, str]) -> dict[str, set[tuple[str, str]]]:
        """The fields of a class, each with the dataclasses that its annotation names."""
        return {
            line.target.id: {named for named in self.named_in(module, line.annotation) if self.is_dataclass(named)}
            for module, name in reversed(self.lineage(key))
            for line in self.classes[module, name].body
            if isinstance(line, ast.AnnAssign) and "ClassVar" not in ast.unparse(line.annotation)
        }

    def given_to_tyro(self) -> set[tuple[str, str]]:
        """The classes of every call of `tyro.cli`, and those whose fields are among their options."""
        found, waiting = set(), set()
        for module, tree in self.trees.items():
            for call in walked(tree) if module != "gof.commands.read" else ():  # which hands on what it is given
                if isinstance(call, ast.Call) and ast.unparse(call.func) in ("tyro.cli", "read_options"):
                    named = self.named_in(module, call.args[0])
                    assert named, f"{module}: tyro.cli is given {ast.unparse(call.args[0])}, which is no class of ours"
                    waiting |= named
        while waiting:
            key = waiting.pop()
            found.add(key)
            waiting |= {inner for named in self.options(key).values() for inner in named} - found
        return found

    def read(self, key: tuple[str, str]) -> set[str]:
        """The fields that are read of objects of a class, in all modules."""
        found = set()
        for older in self.lineage(key):  # a function that takes the class that it is made from reads them too
            for module, tree in self.trees.items():
                if older in self.known[module]:
                    found.update(self._read_in(older, module, tree))
        return found

    def _read_in(self, key: tuple[str, str], module: str, tree: ast.Module) -> Iterator[str]:
        parts = [*tree.body, *(method for part in tree.body if isinstance(part, ast.ClassDef) for method in part.body)]
        kept = self._kept(key, module, tree)
        for part in parts:
            if isinstance(part, ast.ClassDef):
                continue
            bound = self._bound(key, module, part, kept)
            if key[0] == module and part in self.classes[key].body:
                bound.add("self")
            for node in walked(part):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.ctx, ast.Load)
                    and holds(node.value, bound, kept)
                ):
                    yield node.attr
                if isinstance(node, ast.Call) and any(holds(value, bound, kept) for value in node.args):
                    called = ast.unparse(node.func)
                    if called in WHOLE:
                        yield from self.options(key)
                    if called == "getattr":
                        yield from (n.value for n in walked(part) if isinstance(n, ast.Constant))
                        yield from (f for named in self.named_in(module, part) - {key} for f in self.options(named))

    def _bound(self, key: tuple[str, str], module: str, part: ast.AST, kept: set[str] = frozenset()) -> set[str]:
        """Names in a function that hold the options: annotated so, or made by `tyro.cli`, the class or `replace`."""
        bound = {n.arg for n in walked(part) if isinstance(n, ast.arg) and key in self.named_in(module, n.annotation)}
        for target, value in assignments(part):
            called = [value.func, *value.args[:1]] if isinstance(value, ast.Call) else []
            made = any(key in self.named_in(module, each) for each in called if isinstance(each, ast.Name))
            if isinstance(target, ast.Name) and (made or holds(value, bound, kept)):
                bound.add(target.id)
        return bound

    def _kept(self, key: tuple[str, str], module: str, tree: ast.Module) -> set[str]:
        """Names of attributes that hold the options: fields annotated so, and what is set to such a name."""
        found = set()
        for node in walked(tree):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                found |= {node.target.id} if key in self.named_in(module, node.annotation) else set()
            if isinstance(node, ast.FunctionDef):
                bound = self._bound(key, module, node)
                found |= {
                    t.attr for t, v in assignments(node) if isinstance(t, ast.Attribute) and holds(v, bound, set())
                }
        return found

    def unread(self) -> set[str]:
        """MODULE.CLASS.FIELD of every option that nothing reads."""
        return {
            f"{module}.{name}.{option}"
            for module, name in self.given_to_tyro()
            for option in self.options((module, name)).keys() - self.read((module, name))
        }


def assignments(part: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Target and value of every assignment; of `a, b = c, d` both."""
    for node in walked(part):
        for target in node.targets if isinstance(node, ast.Assign) else ():
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                yield from zip(target.elts, node.value.elts, strict=False)
            else:
                yield target, node.value


def holds(value: ast.AST, bound: set[str], kept: set[str]) -> bool:
    """Whether an expression is one of these names, or an attribute of one of those."""
    return (isinstance(value, ast.Name) and value.id in bound) or (
        isinstance(value, ast.Attribute) and value.attr in kept
    )


def source_of(paths: dict[str, Path]) -> Source:
    ours = {name: path for name, path in paths.items() if name.split(".")[0] in ("gof", "gof_benchmark")}
    return Source({name: ast.parse(path.read_text(encoding="utf-8")) for name, path in ours.items()})


READS = """
import tyro
from dataclasses import dataclass

@dataclass
class Inner:
    deep: int = 0
    lost: int = 0

@dataclass
class Config:
    inner: Inner
    plain: int = 0
    by_name: int = 0
    in_a_method: int = 0
    kept: int = 0
    written: int = 0
    unread: int = 0
    of_another: int = 0

    def half(self):
        return self.in_a_method / 2

class Worker:
    def __init__(self, config: Config):
        self.config, self.n = config, 1

    def work(self):
        return self.config.kept

def main(argv):
    config = tyro.cli(Config, args=argv)
    config.written = 1
    return config.plain + getattr(config, "by_name") + config.half() + config.inner.deep + helper(argv)

def helper(other):
    return other.of_another
"""


def test_an_option_that_nothing_reads_is_found():
    """Set is not read, and an attribute of that name of something else is none of ours."""
    unread = Source({"a": ast.parse(READS)}).unread()
    assert unread == {"a.Config.written", "a.Config.unread", "a.Config.of_another", "a.Inner.lost"}


@pytest.mark.long
@pytest.mark.checkout
def test_every_option_is_read():
    source = source_of(modules())
    assert len(source.given_to_tyro()) > 80
    assert not source.unread()
