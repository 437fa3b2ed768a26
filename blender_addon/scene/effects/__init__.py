"""Effects a scene spec may list. Each is one module here; adding an effect means adding one file.

A module holds ``Settings`` (a frozen dataclass, the JSON form of the effect) and some of these, all optional:

``apply(fire, settings, spec)``
    changes a built ``scene.fire.FireObjects`` before the bake. Only here and where the scene is open may an effect
    import bpy.
``ABSORBS_LIGHT = True``
    says that the effect dims what is behind it, so that frames cannot be rendered as the fire-free plate plus the
    fire's light.
``steps_per_frame(settings) -> int``
    solver steps it needs from one frame to the next.
``timing(settings, spec, camera, frame) -> shutter.Timing``
    what it adds to the time at which a picture is taken.
``overlay(light, settings, spec, camera, frame) -> light``
    draws over the light that reaches the sensor, (H, W, 3) linear; frame -1 is the plate. The scene is open.
``board_mask(settings, spec, camera) -> mask``
    (H, W) in [0, 1], 1 where a sync board is, which scores leave out; for the dataset. The scene is open.
``expose(light, settings, spec, camera, frame) -> light``
    turns the light that reaches the sensor, likewise, into what the sensor reports.
``ENCODES = True``
    says that the display pictures of a camera pass through a codec as one video (``scene.video``).
"""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from ...pure.shutter import Timing

if TYPE_CHECKING:
    from ...pure.spec import SceneSpec


def names() -> list[str]:
    """Names of all effects, sorted."""
    return sorted(item.name for item in pkgutil.iter_modules(__path__))


def module(name: str) -> ModuleType:
    """The module of one effect."""
    return importlib.import_module(f".{name}", __name__)


def name_of(settings: Any) -> str:
    """Name of the effect that a settings object belongs to."""
    return type(settings).__module__.rpartition(".")[2]


def apply(fire, settings: Any, spec: SceneSpec) -> None:
    """Let an effect change the scene before the bake."""
    if hook := _hook(settings, "apply"):
        hook(fire, settings, spec)


def changes_scene(settings: Any) -> bool:
    """Whether an effect is something in the scene, not in the camera."""
    return _hook(settings, "apply") is not None


def absorbs_light(settings: Any) -> bool:
    """Whether the effect dims what is behind it."""
    return bool(_hook(settings, "ABSORBS_LIGHT"))


def encodes(settings: Any) -> bool:
    """Whether the effect passes the display pictures through a codec."""
    return bool(_hook(settings, "ENCODES"))


def steps_per_frame(settings: Any) -> int:
    """Solver steps an effect needs per frame."""
    hook = _hook(settings, "steps_per_frame")
    return hook(settings) if hook else 1


def touches_time(settings: Any) -> bool:
    """Whether an effect changes when pictures are taken."""
    return _hook(settings, "timing") is not None


def timing(settings: Any, spec: SceneSpec, camera: int, frame: int) -> Timing:
    """What an effect adds to the time of a picture."""
    hook = _hook(settings, "timing")
    return hook(settings, spec, camera, frame) if hook else Timing()


def expose(light: np.ndarray, spec: SceneSpec, camera: int, frame: int) -> np.ndarray:
    """Rendered light to what the sensor reports: what is drawn over it first, then the sensor, in the order of the spec."""
    for name in ("overlay", "expose"):
        for settings in spec.effects:
            if hook := _hook(settings, name):
                light = hook(light, settings, spec, camera, frame)
    return light


def shows_board(spec: SceneSpec) -> bool:
    """Whether pictures have a board in them that scores leave out."""
    return any(_hook(settings, "board_mask") for settings in spec.effects)


def board_mask(spec: SceneSpec, camera: int) -> np.ndarray:
    """(H, W) in [0, 1]: 1 where a board is."""
    return sum(hook(settings, spec, camera) for settings in spec.effects if (hook := _hook(settings, "board_mask")))


def _hook(settings: Any, name: str):
    return getattr(module(name_of(settings)), name, None)
