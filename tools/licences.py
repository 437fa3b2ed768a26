"""Packages that each extra installs: how much of them, and under which licences; from the packages' own metadata.

    python tools/licences.py     the table of docs/install.md

Metadata do not say what a wheel has inside of other people. Where that is copyleft, `INSIDE` does, and docs/install.md.
"""

from __future__ import annotations

import importlib.metadata
import re
import sys
from collections.abc import Iterable

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

NAME = "gaussians-on-fire"
COPYLEFT = re.compile(
    r"\b([AL]?GPL|GNU|MPL|Mozilla|EUPL|European Union Public|CDDL|EPL|Eclipse|OSL|SSPL|CC[- ]BY[- ](SA|NC))", re.I
)
# TOST-1.0, of OpenUSD, is Apache-2.0 with another section on trademarks.
FREE = re.compile(
    r"\b(MIT|BSD|0BSD|Apache|ISC|PSF|Python Software Foundation|Zlib|Unlicense|CC0|BSL-1\.0|HPND|TOST-1\.0)", re.I
)
# May be copyleft although it comes with other extras than `blender`: name -> (licence, why that binds no user here).
EXCEPTIONS = {
    "certifi": ("MPL-2.0", "a list of certificates, used unchanged (requests, of mkdocs)"),
    "hypothesis": ("MPL-2.0", "a tool of the tests, used unchanged"),
    "pathspec": ("MPL-2.0", "a tool of the documents' site and of mypy, used unchanged"),
}
# Copyleft in a wheel that metadata do not tell: name -> (licence, what it is, words that stand in a binary).
INSIDE = {
    "pycolmap": ("GPL-2.0-or-later", "CHOLMOD's supernodal module and SuiteSparseQR", b"CHOLMOD/Supernodal"),
    "opencv-contrib-python-headless": ("LGPL-2.1-or-later", "FFmpeg, as libraries of its own", b"LGPL version 2.1"),
}
# Metadata that say nothing; their licence file was read instead: name -> (licence, words of that file).
SILENT = {"openexr": ("BSD-3-Clause", "Redistribution and use in source and binary forms")}


def licence(distribution: importlib.metadata.Distribution) -> str:
    """Return a package's statement of its licence, in its own words; "unknown" if there is none."""
    metadata = distribution.metadata
    if expression := metadata.get("License-Expression"):
        return expression
    named = [c.split(" :: ")[-1] for c in metadata.get_all("Classifier") or [] if c.startswith("License :: ")]
    named = [name for name in named if name not in ("OSI Approved", "DFSG approved")]
    first = (metadata.get("License") or "").strip().split("\n")[0]
    if named or first:
        return " AND ".join(named) or first
    stated, words = SILENT.get(canonicalize_name(metadata["Name"]), ("unknown", None))
    texts = [f.read_text() for f in distribution.files or [] if "LICENSE" in f.name.upper() and f.locate().exists()]
    return stated if words and any(words in text for text in texts) else "unknown"


def brought_by(name: str, extras: Iterable[str] = ()) -> dict[str, importlib.metadata.Distribution | None]:
    """Return every package that one needs with these extras, by its plain name, itself left out; None: not
    installed."""
    found: dict[str, importlib.metadata.Distribution | None] = {}
    waiting, seen = [(name, extra) for extra in ["", *extras]], set()
    while waiting:
        package, extra = waiting.pop()
        if (package, extra) in seen:
            continue
        seen.add((package, extra))
        try:
            distribution = importlib.metadata.distribution(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = None
            continue
        found[package] = distribution
        for line in distribution.requires or []:
            needed = Requirement(line)
            if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                waiting += [(canonicalize_name(needed.name), inner) for inner in ["", *needed.extras]]
    del found[name]
    return found


def objections(packages: dict[str, importlib.metadata.Distribution | None]) -> list[str]:
    """Return the faults in the licences of packages for one who does not want copyleft."""
    wrong = []
    for name, distribution in sorted(packages.items()):
        if distribution is None:
            continue
        said = licence(distribution)
        expected, _ = EXCEPTIONS.get(name, (None, None))
        if COPYLEFT.search(said):
            if expected is None or not re.search(rf"{expected}|{expected[:3]}", said):
                wrong.append(f"{name}: {said}")
        elif not FREE.search(said):
            wrong.append(f"{name}: '{said}' is no licence that tools/licences.py knows")
    return wrong


def size_mb(distribution: importlib.metadata.Distribution) -> float:
    """Return the size of its files as they were installed, before Python compiles them."""
    return sum(file.size or 0 for file in distribution.files or []) / 2**20


def extras() -> list[str]:
    return importlib.metadata.metadata(NAME).get_all("Provides-Extra") or []


def main() -> int:
    print("| extra | packages it adds | MB | not MIT, BSD or Apache |\n|---|---|---|---|")
    base = brought_by(NAME)
    for extra in ["", *extras()]:
        packages = brought_by(NAME, [extra])
        added = packages if not extra else {k: v for k, v in packages.items() if k not in base}
        others = [f"{name} ({licence(d)})" for name, d in added.items() if d and COPYLEFT.search(licence(d))]
        others += [f"{name} ({INSIDE[name][0]} inside)" for name in added if name in INSIDE]
        absent = [f"{name} (not installed here)" for name, d in added.items() if d is None]
        size = sum(size_mb(d) for d in added.values() if d)
        print(f"| {extra or '(none)'} | {len(added)} | {size:.0f} | {', '.join(sorted(others + absent)) or '-'} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
