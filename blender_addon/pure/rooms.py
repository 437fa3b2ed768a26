"""How much room the built-in surroundings leave for a fire and its cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .camera_poses import positions

if TYPE_CHECKING:
    from .spec import SceneSpec


@dataclass(frozen=True)
class Room:
    """The free air of surroundings, world metres: from the floor's edges to the wall or what stands before it."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    wall: str
    """What stands at the far side, y = high[1]."""


ROOMS = {
    "studio": Room((-4.0, -4.0, 0.0), (4.0, 1.95, 5.0), "backdrop"),
    "workshop": Room((-4.5, -4.5, 0.0), (4.5, 1.4, 4.0), "shelves"),
    "classroom": Room((-4.5, -4.5, 0.0), (4.5, 1.0, 4.0), "desks"),
    "cloister": Room((-5.0, -4.65, 0.0), (5.0, 1.3, 4.0), "arcade"),
}
SPARE = 1.05


def studio_scale(spec: SceneSpec) -> float:
    """How many times its own size the studio is built, so that fire and cameras stand in it; 1 where they do."""
    room, box = ROOMS["studio"], spec.box
    reach = [high / there for high, there in zip(box.max, room.high, strict=True)]
    reach += [low / there for low, there in zip(box.min[:2], room.low[:2], strict=True)]
    cameras = positions(spec.cameras)
    reach += [np.abs(cameras[:, 0]).max() / room.high[0], (cameras[:, 1] / room.low[1]).max()]
    most = float(max(reach))
    return 1.0 if most <= 1 else SPARE * most
