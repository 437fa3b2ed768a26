"""Video compression: the display pictures of each camera are what a decoder makes of their H.264 video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...core.checked_json import require

ENCODES = True


@dataclass(frozen=True)
class Settings:
    quality: Literal["lossless", "perc_lossless", "high", "medium", "low", "verylow", "lowest"] = "medium"
    """Blender's names for H.264 constant rate factors 0, 17, 20, 23, 26, 29 and 32 (8 bits, 4:2:0 colour)."""
    key_frame_every: int = 12
    """Frames from one complete picture to the next."""

    def __post_init__(self):
        require(
            self.key_frame_every >= 1, "effects.video_compression.key_frame_every", "at least 1", self.key_frame_every
        )
