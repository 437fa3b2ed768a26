"""From where a scene's flame was filmed: what other sides show is a guess."""

import math

import bpy
from mathutils import Vector

from . import captured, place

GUESSED_DEG = 20.0  # from the nearest camera on, a flame's shape is a guess
HELD_OUT = ("eval", "around")  # names of cameras that no method learns from begin so
AHEAD = Vector((0.0, 0.0, -1.0))  # a camera's and a view's own axis


def cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the cameras of the scene's rig, or of its capture, that a method may learn from."""
    named = [(place.part_of(thing) or thing.get(captured.NAME), thing) for thing in scene.objects]
    return [thing for name, thing in named if thing.type == "CAMERA" and name and not name.startswith(HELD_OUT)]


def guess(scene: bpy.types.Scene, forward: Vector) -> str | None:
    """Return in words how far a view is from the nearest camera that filmed; None where it is near.

    Args:
        forward: where the view looks, in the world; any length above 0.
    """
    filmed = cameras(scene)
    if not filmed:
        return "Sides that no camera filmed are guesses"
    away = min(math.degrees(forward.angle(camera.matrix_world.to_3x3() @ AHEAD)) for camera in filmed)
    return f"{away:.0f}° from the nearest camera: its shape is a guess" if away > GUESSED_DEG else None
