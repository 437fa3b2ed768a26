"""Effects on the open Blender scene; ``pure.effects`` states the contract of both their halves."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import numpy as np

from ...pure.effects import name_of, shows_board
from ...pure.spec import SceneSpec
from ..fire_objects import FireObjects

NAMES = {item.name for item in pkgutil.iter_modules(__path__)}
"""Effects that have a half here."""


def apply(fire: FireObjects, settings: Any, spec: SceneSpec) -> None:
    """Let an effect change the scene before the bake."""
    if hook := _hook(settings, "apply"):
        hook(fire, settings, spec)


def changes_scene(settings: Any) -> bool:
    """Return whether an effect is something in the scene, not in the camera."""
    return _hook(settings, "apply") is not None


def overlay(light: np.ndarray, spec: SceneSpec, camera: int, frame: int) -> np.ndarray:
    """Turn rendered light (H, W, 3) into the light that reaches the sensor: what effects draw over it."""
    for settings in spec.effects:
        if hook := _hook(settings, "overlay"):
            light = hook(light, settings, spec, camera, frame)
    return light


def board_mask(spec: SceneSpec, camera: int) -> np.ndarray:
    """Return (H, W) in [0, 1]: 1 where a board is."""
    return sum(
        _hook(settings, "board_mask")(settings, spec, camera) for settings in spec.effects if shows_board(settings)
    )


def _hook(settings: Any, name: str) -> Any:
    effect = name_of(settings)
    return getattr(importlib.import_module(f".{effect}", __name__), name, None) if effect in NAMES else None
