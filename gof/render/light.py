"""Emissive Gaussians over what lies behind them, differentiable; `gof.core.colour.add_light` is the plain twin."""

from __future__ import annotations

import drjit as dr

from gof.render.backend import Float, UInt

LINEAR_BELOW, DARK = 0.04045, 0.0031308  # display value and light up to which sRGB is a straight line


def add_light(color: list[Float], alpha: Float, background: list) -> list[Float]:
    """Return three planes of display values; see the twin. Gradients flow to all planes; none is clipped.

    Args:
        color, background: three planes of display values each; of the background, numbers will do.
    """
    return _show(color, alpha, [to_light(Float(b)) for b in background])


def show_before(color: list[Float], alpha: Float, behind: list[Float], pictures: int = 1) -> list[Float]:
    """Return three planes of display values of K pictures of emissive Gaussians before one plate; differentiable.

    Args:
        color, alpha: (K * P,) each, as `add_light`.   behind: three planes (P,) of linear light.   pictures: K.
    """
    return dr.custom(_ShowBefore, color, alpha, behind, pictures)


class _ShowBefore(dr.CustomOp):
    """Finds all gradients in one kernel: Dr.Jit would start one for each plane behind, and the light again in each."""

    def eval(self, color, alpha, behind, pictures):
        self.inputs, self.pictures = dr.detach((color, alpha, behind)), pictures
        color, alpha, behind = self.inputs
        return _show(color, alpha, [_repeat(plane, pictures) for plane in behind])

    def backward(self):
        color, alpha, behind = self.inputs
        behind = [_repeat(plane, self.pictures) for plane in behind]
        inputs = [Float(plane) for plane in (*color, alpha, *behind)]
        with dr.isolate_grad():
            dr.enable_grad(inputs)
            shown = _show(inputs[:3], inputs[3], inputs[4:])
            for plane, gradient in zip(shown, self.grad_out(), strict=True):
                dr.set_grad(plane, gradient)
            dr.enqueue(dr.ADMode.Backward, shown)
            dr.traverse(dr.ADMode.Backward)
            gradients = [dr.grad(plane) for plane in inputs]
        dr.eval(gradients)
        self.set_grad_in("color", gradients[:3])
        self.set_grad_in("alpha", gradients[3])
        self.set_grad_in("behind", [_add_pictures(plane, self.pictures) for plane in gradients[4:]])

    def name(self):
        return "show before"


def _show(color: list[Float], alpha: Float, behind: list) -> list[Float]:
    return [to_display(light) for light in sum_light(color, alpha, behind)]


def _repeat(plane: Float, pictures: int) -> Float:
    """Return a plane once for each picture."""
    if pictures == 1:
        return plane
    place = dr.arange(UInt, pictures * len(plane)) % UInt(len(plane))
    return dr.gather(Float, plane, place)


def _add_pictures(planes: Float, pictures: int) -> Float:
    """Return the sum of a plane's pictures."""
    if pictures == 1:
        return planes
    place = dr.arange(UInt, len(planes) // pictures)
    return sum(dr.gather(Float, planes, place + k * len(place)) for k in range(pictures))


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
