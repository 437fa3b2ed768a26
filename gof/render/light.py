"""Emissive Gaussians over what lies behind them, differentiable; `gof.core.colour.add_light` is the plain twin."""

from __future__ import annotations

import drjit as dr

from gof.render.backend import Float

LINEAR_BELOW, DARK = 0.04045, 0.0031308  # display value and light up to which sRGB is a straight line


def add_light(color: list[Float], alpha: Float, background: list) -> list[Float]:
    """Return three planes of display values; see the twin. Gradients flow to all planes; none is clipped.

    Args:
        color, background: three planes of display values each; of the background, numbers will do.
    """
    behind = [to_light(Float(b)) for b in background]
    return [to_display(light) for light in sum_light(color, alpha, behind)]


def sum_light(color: list[Float], alpha: Float, behind: list) -> list[Float]:
    """Return three planes of linear light of emissive Gaussians over linear light `behind`; args as `add_light`."""
    brightest = dr.maximum(dr.maximum(color[0], color[1]), color[2])
    through = 1 - dr.maximum(alpha - brightest, 0)
    return [b * through + to_light(c) for c, b in zip(color, behind, strict=True)]


def to_light(display: Float) -> Float:
    """Linear light of display values (sRGB)."""
    # The powers' derivatives are unbounded at 0, where the straight line is chosen.
    curve = dr.power((dr.maximum(display, LINEAR_BELOW) + 0.055) / 1.055, 2.4)
    return dr.select(display > LINEAR_BELOW, curve, display / 12.92)


def to_display(light: Float) -> Float:
    """Display values (sRGB) of linear light; above 1 the curve goes on."""
    return dr.select(light > DARK, 1.055 * dr.power(dr.maximum(light, DARK), 1 / 2.4) - 0.055, 12.92 * light)
