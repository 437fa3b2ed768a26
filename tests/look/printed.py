"""What is on a figure that matplotlib wrote as SVG."""

from __future__ import annotations

import re


def texts(svg: str) -> list[str]:
    """What a figure says: matplotlib writes the words of every text beside its glyphs."""
    return [words.strip() for words in re.findall(r"<!-- (.*?) -->", svg)]


def marks(svg: str) -> dict[str, list[tuple[float, float]]]:
    """Places (pt, y downwards) of a chart's marks by colour; the legend's, which nothing cuts off, are left out."""
    found: dict[str, list[tuple[float, float]]] = {}
    for inside in re.findall(r"<g clip-path[^>]*>\s*((?:<use [^>]*/>\s*)+)</g>", svg):
        for x, y, colour in re.findall(r'x="([\d.]+)" y="([\d.]+)" style="fill: (#\w+)', inside):
            found.setdefault(colour, []).append((float(x), float(y)))
    return found


def curves(svg: str, colour: str) -> list[list[tuple[float, float]]]:
    """The lines of a colour, each its points (pt, y downwards), as they are cut to the axes."""
    paths = re.findall(r'<path d="([^"]*)" clip-path[^>]*stroke: ' + colour, svg)
    return [[(float(x), float(y)) for x, y in re.findall(r"[ML] ([\d.]+) ([\d.]+)", path)] for path in paths]
