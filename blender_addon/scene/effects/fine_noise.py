"""Fine noise: switched on in the domain."""

from __future__ import annotations

from ...pure.effects.fine_noise import Settings
from ...pure.spec import SceneSpec
from ..fire_objects import FireObjects


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    domain = fire.domain_settings
    domain.use_noise = True
    domain.noise_scale = settings.scale
    domain.noise_strength = settings.strength
    domain.noise_pos_scale = settings.size
