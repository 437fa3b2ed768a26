"""The text of OpenFOAM's dictionaries, from Python's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gof.core.files import atomic_path

END = "// * //\n"  # OpenFOAM's own files end in a line like this; a file that was cut off lacks it


def render(value: Any, indent: int = 0) -> str:
    """Return a value as OpenFOAM reads it: dict -> {...}, sequence -> (...), bool -> yes/no; text stands as it is."""
    pad = "    " * indent
    if isinstance(value, dict):
        return f"{pad}{{\n{render_entries(value, indent + 1)}{pad}}}\n"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple | np.ndarray):
        return f"({' '.join(render(v) for v in value)})"
    if isinstance(value, float):
        return f"{value:.10g}"
    return str(value)


def render_entries(entries: dict[str, Any], indent: int = 0) -> str:
    """Return the entries of a dictionary, one a line (or a block)."""
    pad = "    " * indent
    lines = []
    for key, value in entries.items():
        if isinstance(value, dict):
            lines.append(f"{pad}{key}\n{render(value, indent)}")
        else:
            lines.append(f"{pad}{key} {render(value)};\n")
    return "".join(lines)


def named(entries: dict[str, dict]) -> str:
    """Return a list of named dictionaries, `( name { ... } ... )`, as blockMesh's boundary and createPatch want it."""
    return "(\n" + "".join(f"{name}\n{render(value)}" for name, value in entries.items()) + ")"


def unnamed(entries: list[dict]) -> str:
    """Return a list of dictionaries without names, `( { ... } ... )`."""
    return "(\n" + "".join(render(value) for value in entries) + ")"


def write_dictionary(path: Path, entries: dict[str, Any], kind: str = "dictionary") -> None:
    """Write a file of entries under the header OpenFOAM asks for; `kind` is its class, for example volScalarField."""
    header = {"FoamFile": {"version": "2.0", "format": "ascii", "class": kind, "object": path.name}}
    with atomic_path(path) as temporary:
        temporary.write_text(render_entries(header) + "\n" + render_entries(entries) + "\n" + END, encoding="ascii")
