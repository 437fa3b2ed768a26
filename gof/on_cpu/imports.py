"""Imports of a script: the stand-ins that an unlisted method needs, and the packages that it lacks."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from gof.core.errors import GofError
from gof.on_cpu import hash_grid
from gof.on_cpu import small_modules as small

RASTERIZER = "diff_gaussian_rasterization"
VARIANTS = {2: "plain", 3: "depth", 6: "spacetime"}  # by the number of things that the code takes from the rasteriser
STAND_INS = {  # by the name that is imported
    "simple_knn._C": small.simple_knn,
    "fused_ssim": small.fused_ssim,
    "hashencoder.backend": hash_grid.backend,
    "mmcv": small.mmcv,
    "kornia": small.kornia,
}
ONLY_IF_ABSENT = ("mmcv", "kornia")  # the real ones run on a CPU


@dataclass
class Imports:
    """The files of a checkout that a script imports at their top, itself first.

    Attributes:
        files: read.   others: full names of modules that are no file of the checkout, or that have a stand-in.
    """

    files: list[Path] = field(default_factory=list)
    others: set[str] = field(default_factory=set)

    def variant(self) -> str:
        """Return which of the rasteriser's variants the code calls.

        Raises:
            GofError: no call of it, calls that differ, or one that takes what no variant returns.
        """
        counts = {count for path in self.files for count in _taken_from_rasterizer(path)}
        if len(counts) != 1 or not counts <= set(VARIANTS):
            raise GofError(
                f"{self.files[0]}: it takes {sorted(counts) or 'nothing'} things from its rasteriser; stand-ins return "
                f"{', '.join(f'{count} ({name})' for count, name in VARIANTS.items())}. Write to us about this method"
            )
        return VARIANTS[counts.pop()]


def read_imports(script: Path) -> Imports:
    """Follow a script's imports from file to file; those within functions, `try` and `if` are not followed.

    Raises:
        GofError: a file that is not Python.
    """
    root, found, waiting = script.resolve().parent, Imports(), [script.resolve()]
    while waiting:
        path = waiting.pop()
        if path in found.files:
            continue
        found.files.append(path)
        for name in _names(path, root):
            if stands := [known for known in (*STAND_INS, RASTERIZER) if f"{name}.".startswith(f"{known}.")]:
                found.others.update(stands)
            elif (root / _head(name)).is_dir() or (root / f"{_head(name)}.py").is_file():
                waiting += _own_files(name, root)
            else:
                found.others.add(name)
    return found


def missing(names: set[str]) -> list[str]:
    """Return the packages of these modules that are not installed."""
    return sorted(package for package in set(map(_head, names)) if find_spec(package) is None)


def _head(name: str) -> str:
    return name.partition(".")[0]


def _parsed(path: Path) -> ast.Module:
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError) as e:
        raise GofError(f"{path}: not a Python file: {e}") from e


def _names(path: Path, root: Path) -> Iterator[str]:
    """Yield full names of what a file of the checkout imports at its top; of "from a import b" both a and a.b."""
    try:
        package = path.parent.relative_to(root).parts
    except ValueError:
        package = ()
    for node in _parsed(path).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            around = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join([*around, *filter(None, [node.module])])
            if base:
                yield base
            yield from (".".join(filter(None, [base, alias.name])) for alias in node.names if alias.name != "*")


def _own_files(name: str, root: Path) -> Iterator[Path]:
    """Yield the files of the checkout that importing a name runs: packages on the way, and the module."""
    place = root
    for part in name.split("."):
        place = place / part
        if (place / "__init__.py").is_file():
            yield place / "__init__.py"
        elif place.with_suffix(".py").is_file():
            yield place.with_suffix(".py")


def _taken_from_rasterizer(path: Path) -> Iterator[int]:
    for node in ast.walk(_parsed(path)):
        if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)):
            continue
        if {"means3D", "means2D"} <= {word.arg for word in node.value.keywords}:
            target = node.targets[0]
            yield len(target.elts) if isinstance(target, ast.Tuple) else 1
