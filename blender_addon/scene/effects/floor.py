"""Floor: Blender's own border collision, at the bottom only."""

from __future__ import annotations

from ...pure.effects.floor import Settings
from ...pure.spec import SceneSpec
from ..fire_objects import FireObjects


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    fire.domain_settings.use_collision_border_bottom = True
