"""Obstacles: solid bodies that the gas flows around. They stand still, and are seen in the pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...core.checked_json import require

CHANGES_BAKE = True


@dataclass(frozen=True)
class Obstacle:
    shape: Literal["sphere", "box"] = "sphere"
    """Ball, or block with sides along the axes."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.6)
    """Centre, world metres."""
    size: tuple[float, float, float] = (0.2, 0.2, 0.2)
    """Side lengths of its bounding box, metres. Give it at least three cells: thinner things leak."""
    colour: tuple[float, float, float] = (0.12, 0.12, 0.13)
    """Linear RGB."""

    def __post_init__(self):
        require(min(self.size) > 0, "effects.obstacles.items.size", "positive on every side", self.size)


@dataclass(frozen=True)
class Settings:
    items: tuple[Obstacle, ...] = (Obstacle(),)
    """The bodies."""
