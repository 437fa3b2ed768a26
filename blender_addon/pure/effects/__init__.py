"""Effects that a scene spec may list. Adding an effect = one file here, and one of the same name in ``scene/effects``
if it changes the Blender scene.

A module here holds ``Settings`` (a frozen dataclass, the JSON form of the effect), never imports bpy, knows nothing of
specs, and may have some of these:

``ABSORBS_LIGHT = True``
    says that the effect dims what is behind it, so that frames cannot be rendered as the fire-free plate plus the
    fire's light.
``CHANGES_BAKE = True``
    says that it needs our own solver, so that a fire that comes as grids cannot have it.
``BEYOND_VELOCITY = True``
    says that it moves the drawn light in a way that is not in the true velocity; ``dataset.json`` says so then.
``steps_per_frame(settings) -> int``
    solver steps it needs from one frame to the next.
``timing(settings, picture) -> ExposureTiming``
    what it adds to the time at which a picture is taken (``pure.timing``).
``expose(light, settings, picture) -> light``
    turns the light that reaches the sensor, (H, W, 3) linear, into what the sensor reports.
``gain(settings, flame) -> factor``
    sets the exposure of all cameras by the flame's pixels (N, 3) in the first picture of the first one.
``SHOWS_BOARD = True``
    says that pictures have a sync board in them, which scores leave out: ``board_mask`` says where.
``ENCODES = True``
    says that the display pictures of a camera pass through a codec as one video (``scene.video``).

A module in ``scene/effects`` works on the open Blender scene and may have some of these:

``apply(fire, settings, spec) -> None``
    changes a built ``scene.fire_objects.FireObjects`` before the bake.
``overlay(light, settings, spec, camera, frame) -> light``
    draws over the light that reaches the sensor, likewise, before any ``expose``; frame -1 is the plate.
``board_mask(settings, spec, camera) -> mask``
    (H, W) in [0, 1], 1 where a sync board is, for the dataset.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from types import ModuleType
from typing import Any

import numpy as np

from ..timing import ExposureTiming, Picture


def names() -> list[str]:
    """Return names of all effects, sorted."""
    return sorted(item.name for item in pkgutil.iter_modules(__path__))


def module(name: str) -> ModuleType:
    """Return the module of one effect."""
    return importlib.import_module(f".{name}", __name__)


def name_of(settings: Any) -> str:
    """Name of the effect that a settings object belongs to."""
    return type(settings).__module__.rpartition(".")[2]


def absorbs_light(settings: Any) -> bool:
    """Return whether the effect dims what is behind it."""
    return bool(_hook(settings, "ABSORBS_LIGHT"))


def changes_bake(settings: Any) -> bool:
    """Return whether the effect needs the solver."""
    return bool(_hook(settings, "CHANGES_BAKE"))


def beyond_velocity(settings: Any) -> bool:
    """Return whether the effect moves the drawn light in a way that is not in the true velocity."""
    return bool(_hook(settings, "BEYOND_VELOCITY"))


def encodes(settings: Any) -> bool:
    """Return whether the effect passes the display pictures through a codec."""
    return bool(_hook(settings, "ENCODES"))


def shows_board(settings: Any) -> bool:
    """Return whether the effect puts a board into the pictures that scores leave out."""
    return bool(_hook(settings, "SHOWS_BOARD"))


def touches_time(settings: Any) -> bool:
    """Return whether the effect changes when pictures are taken."""
    return _hook(settings, "timing") is not None


def steps_per_frame(settings: Any) -> int:
    """Solver steps that the effect needs per frame."""
    hook = _hook(settings, "steps_per_frame")
    return hook(settings) if hook else 1


def timing(settings: Any, picture: Picture) -> ExposureTiming:
    """Return the time that the effect adds to a picture."""
    hook = _hook(settings, "timing")
    return hook(settings, picture) if hook else ExposureTiming()


def expose(light: np.ndarray, listed: tuple[Any, ...], picture: Picture) -> np.ndarray:
    """Return (H, W, 3) linear light on the sensor to what the sensor reports: each effect in the order of the spec."""
    for settings in listed:
        if hook := _hook(settings, "expose"):
            light = hook(light, settings, picture)
    return light


def meters(settings: Any) -> bool:
    """Return whether the effect sets the exposure by what the first picture shows."""
    return _hook(settings, "gain") is not None


def gain(listed: tuple[Any, ...], flame: np.ndarray) -> float:
    """Factor on the light of all pictures, from the flame's pixels (N, 3) in the first."""
    return math.prod(_hook(settings, "gain")(settings, flame) for settings in listed if meters(settings))


def _hook(settings: Any, name: str) -> Any:
    return getattr(module(name_of(settings)), name, None)
