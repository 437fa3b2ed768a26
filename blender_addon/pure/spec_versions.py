"""Scene specs of older versions in the words of today."""

from __future__ import annotations

from typing import Any

VERSION_1_FIRE = {"light": "reaction", "speeds": "solver"}


def from_version_1(data: dict) -> dict:
    """Of a spec of version 1 the same fire in the words of today: its defaults were those of our first fires."""
    fire = data.get("fire", {})
    if isinstance(fire, dict) and "grids" not in fire:
        data = data | {"fire": VERSION_1_FIRE | fire}
    listed = data.get("effects", [])
    if isinstance(listed, list):
        data = data | {"effects": [_effect_from_version_1(item) for item in listed]}
    return data


def _effect_from_version_1(item: Any) -> Any:
    if isinstance(item, dict) and item.get("name") == "wind":
        return {"strength": 0.3, "unit": "field"} | item
    return item
