"""Whether the domain cuts the flame off, measured once it is simulated."""

from __future__ import annotations

import numpy as np

from ..pure.spec import SceneSpec
from .flame_source import FlameSource

LOOKED_AT = 4  # frames of the clip
SIDES = {"top": (2, -1), "-x side": (0, 0), "+x side": (0, -1), "-y side": (1, 0), "+y side": (1, -1)}
"""Axis and end. Not the bottom: burners stand there."""


def cut_off(spec: SceneSpec, source: FlameSource) -> dict[str, float]:
    """Light in the outermost layer of cells over that of the flame's widest section along the axis, per side; the
    largest of some frames. 0 without a flame."""
    frames = sorted({round(k) for k in np.linspace(0, spec.clip.frames - 1, LOOKED_AT)})
    shares = {side: 0.0 for side in SIDES}
    for frame in frames:
        light = source.light(spec.timeline.blender_frame(frame)).astype(np.float64)
        for side, (axis, end) in SIDES.items():
            sections = light.sum(axis=tuple(other for other in range(3) if other != axis))
            if sections.max() > 0:
                shares[side] = max(shares[side], float(sections[end] / sections.max()))
    return {side: round(share, 4) for side, share in shares.items()}
