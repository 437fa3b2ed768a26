"""The unit of a number of a spec: by the end of its field's name or, without one, by the words of its description."""

from __future__ import annotations

SUFFIXES = {  # longest first
    "ev_per_s": "EV/s",
    "m_s": "m/s",
    "deg": "°",
    "us": "µs",
    "mm": "mm",
    "px": "px",
    "ev": "EV",
    "s": "s",
    "m": "m",
}
WORDS = {
    "metres": "m",
    "seconds": "s",
    "electrons": "e⁻",
    "stops": "EV",
    "metre": "1/m",
    "cells": "cells",
    "percent": "%",
    "m/s": "m/s",
}


def unit_in(name: str) -> tuple[str, str]:
    """Return a field's name without the unit at its end, and this; "" where there is none."""
    for suffix, unit in SUFFIXES.items():
        if name.endswith(f"_{suffix}"):
            return name.removesuffix(f"_{suffix}"), unit
    return name, ""


def unit_of(name: str, note: str) -> str:
    """Return the unit of a field with a description; "" for a pure number."""
    words = note.replace(",", " ").replace(".", " ").split()
    return unit_in(name)[1] or next((WORDS[word] for word in reversed(words) if word in WORDS), "")
