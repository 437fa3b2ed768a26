"""From display values back to scene-linear light, through whatever view transform the scene uses."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
import numpy as np

STOPS = np.linspace(-14.0, 8.0, 1024)  # linear greys measured, in powers of two


def scene_linear(color: np.ndarray, scene: bpy.types.Scene) -> np.ndarray:
    """Linear values that the scene's view transform shows as the given display values.

    The transform is measured on a grey ramp and inverted channel by channel: exact for greys, close for colours (view
    transforms such as Filmic also desaturate bright colours). Values are limited to what the ramp reaches, so a pure
    white gives a large but finite light.

    Args:
        color: (N, 3) display values; outside [0, 1] they are clipped.
    Returns:
        (N, 3) float32, >= 0.
    """
    linear = np.concatenate([[0.0], 2.0**STOPS])
    shown = np.maximum.accumulate(_shown(linear, scene))
    # Flat parts of the curve (black, white) are reached at their first value.
    distinct, first = np.unique(shown, return_index=True)
    return np.interp(np.clip(color, 0, 1), distinct, linear[first]).astype(np.float32)


def _shown(linear: np.ndarray, scene: bpy.types.Scene) -> np.ndarray:
    """Display values in [0, 1] of linear greys (N,)."""
    ramp = bpy.data.images.new("tone curve", len(linear), 1, float_buffer=True, is_data=False)
    ramp.colorspace_settings.name = "Linear Rec.709"
    ramp.pixels.foreach_set(np.column_stack([linear] * 3 + [np.ones(len(linear))]).ravel().astype(np.float32))
    settings = scene.render.image_settings
    kept = {key: getattr(settings, key) for key in ("file_format", "color_mode", "color_depth")}
    seen = None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ramp.png"
        try:
            settings.file_format = "PNG"
            settings.color_mode, settings.color_depth = "RGB", "16"
            ramp.save_render(str(file), scene=scene)
            seen = bpy.data.images.load(str(file))
            seen.colorspace_settings.name = "Non-Color"
            pixels = np.empty(len(linear) * 4, np.float32)
            seen.pixels.foreach_get(pixels)
        finally:
            for key, value in kept.items():
                setattr(settings, key, value)
            for image in (ramp, seen):
                if image is not None:
                    bpy.data.images.remove(image)
    return pixels.reshape(-1, 4)[:, 0].astype(np.float64)
