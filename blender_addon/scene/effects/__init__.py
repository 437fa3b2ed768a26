"""Effects a scene spec may list. Each is one module here; adding an effect means adding one file.

A module holds ``Settings`` (a frozen dataclass, the JSON form of the effect) and ``apply(fire, settings, spec)``,
which changes a built ``scene.fire.FireObjects`` before the bake. ``ABSORBS_LIGHT = True`` says that the effect dims
what is behind it, so that frames cannot be rendered as the fire-free plate plus the fire's light. Modules import bpy
only inside ``apply``.
"""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import Any


def names() -> list[str]:
    """Names of all effects, sorted."""
    return sorted(item.name for item in pkgutil.iter_modules(__path__))


def module(name: str) -> ModuleType:
    """The module of one effect."""
    return importlib.import_module(f".{name}", __name__)


def name_of(settings: Any) -> str:
    """Name of the effect that a settings object belongs to."""
    return type(settings).__module__.rpartition(".")[2]


def absorbs_light(settings: Any) -> bool:
    """Whether the effect of a settings object dims what is behind it."""
    return getattr(module(name_of(settings)), "ABSORBS_LIGHT", False)
