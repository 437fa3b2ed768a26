"""L1 + SSIM image loss (Kerbl et al. 2023, equation 7) as four passes over memory, and its analytic adjoint.

All channels of all pictures lie in one strip of memory, row after row, with zeros between rows and between pictures. A
neighbour k pixels away is then the same strip read k places later, so a blur is a sum of shifted strips: contiguous
loads, no index arithmetic, no border case. Terms of the ground truth alone are computed once per `Target`. The forward
pass leaves the derivatives of SSIM with respect to three local moments behind and the backward pass blurs those (the
window is symmetric and zero outside the image, so the blur is its own adjoint).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import drjit as dr
import numpy as np

from gof.core.errors import DataFormatError
from gof.render.backend import Float, UInt, floats, kernels, shifted
from gof.render.ssim import C1, C2, REACH, WINDOW

ALIGN = 16  # floats; a blur along rows shortens a strip by this at both ends, so that strips stay on cache lines


@dataclass(frozen=True)
class Strip:
    """Places of the pixels of pictures of one size in a strip: by channels, and in a channel by pictures."""

    pictures: int
    height: int
    width: int
    channels: int

    @property
    def row(self) -> int:
        return -(-(self.width + REACH) // ALIGN) * ALIGN

    @property
    def plane(self) -> int:
        """Places of a channel's pictures, each with the zeros below it."""
        return self.pictures * (self.height + REACH) * self.row

    @property
    def margin(self) -> int:
        """Zeros at both ends: a blur along rows and columns, and its adjoint."""
        return 2 * (ALIGN + REACH * self.row)

    @property
    def size(self) -> int:
        return self.channels * self.plane + 2 * self.margin

    def fill(self, image: np.ndarray) -> Float:
        """Return a strip of a (K, H, W, D) image."""
        strip = np.zeros(self.size, np.float32)
        body = strip[self.margin : self.size - self.margin].reshape(self.channels, self.pictures, -1, self.row)
        body[:, :, : self.height, : self.width] = image.transpose(3, 0, 1, 2)
        return floats(strip)

    def pixels(self, channel: int, margin: int) -> UInt:
        """Places of a channel's pixels (K * H * W,) in a strip that has this margin left."""
        i = dr.arange(UInt, self.pictures * self.height * self.width)
        places = i + (i // self.width) * (self.row - self.width) + (margin + channel * self.plane)
        if self.pictures > 1:  # a lone picture needs no second division
            places += (i // (self.height * self.width)) * (REACH * self.row)
        return places


@cache
def _even_weight(strip: Strip) -> Float:
    """Return the weight that all unmasked targets of a size share."""
    return _weight(strip, np.ones((strip.pictures, strip.height, strip.width)))


def _weight(strip: Strip, mask: np.ndarray) -> Float:
    weight = np.broadcast_to((mask / (mask.sum() * strip.channels))[..., None], (*mask.shape, strip.channels))
    return _inner(strip.fill(weight), strip.row)


class Target:
    """A ground-truth image, or several of one size, with their blurred moments.

    Several are compared at once with pictures that stand one below the other in every plane. Each is as if alone: the
    windows see zeros beyond its border, never its neighbour.

    Args:
        image: (H, W, D) values in display range [0, 1], or (K, H, W, D) for K pictures.
        mask: (H, W), or (K, H, W) for K pictures: non-negative weight of every pixel in all terms; None = 1. Weights
            are divided by their sum over all pictures.

    Raises:
        DataFormatError: shapes disagree, or the weights sum to 0.
    """

    def __init__(self, image: np.ndarray, mask: np.ndarray | None = None):
        image = np.asarray(image, np.float32)
        if image.ndim not in (3, 4) or not image.size:
            raise DataFormatError(
                f"target image has shape {image.shape}, expected (H, W, D) or (K, H, W, D), all of them at least 1"
            )
        if mask is not None and (np.shape(mask) != image.shape[:-1] or not np.sum(mask) > 0):
            raise DataFormatError(
                f"target mask has shape {np.shape(mask)} and sum {np.sum(mask):g}; expected {image.shape[:-1]}, > 0"
            )
        image = image.reshape(-1, *image.shape[-3:])
        mask = None if mask is None else np.reshape(mask, image.shape[:-1])
        self.shape = image.shape  # (K, H, W, D)
        kind = _Strips
        if kernels().name == "native":
            from gof.render.native.loss import NativeTarget as kind
        self.moments = kind(image, mask)


class _Strips:
    """Data of a target (K, H, W, D) that the Dr.Jit kernels read."""

    def __init__(self, image: np.ndarray, mask: np.ndarray | None):
        self.strip = Strip(*image.shape)
        self.weight = _even_weight(self.strip) if mask is None else _weight(self.strip, np.asarray(mask, np.float64))
        self.image = _row_neighbours(self.strip.fill(image))
        rows = [_blur(self.image), _blur_product(self.image, self.image)]
        dr.eval(rows)
        self.mu, self.square = (_blur(_column_neighbours(v, self.strip.row)) for v in rows)
        dr.eval(self.mu, self.square)

    @property
    def operation(self) -> type[dr.CustomOp]:
        return _L1SSIM


def l1_ssim(
    image: list[Float], target: Target | np.ndarray, ssim_weight: float = 0.2, square_weight: float = 0.0
) -> Float:
    """(1 - w) mean |x - y| + w (1 - mean SSIM) + s mean (x - y)^2, an AD scalar; w and s are the weights.

    Where the target holds K pictures, the mean of the K pictures' losses.

    SSIM with an 11x11 window of sigma 1.5 px, zero beyond the border, constants for a range of 1. |x - y| has gradient
    0 where x = y. Values far outside [0, 1] lose digits in the local variances.

    Args:
        image: D planes (H * W,), row-major; of K pictures (K * H * W,), one picture after the other.
        target: a `Target`, or an (H, W, D) or (K, H, W, D) array (then its moments are computed every time).
    Raises:
        DataFormatError: number of channels or pixels differ.
    """
    if not isinstance(target, Target):
        target = Target(target)
    pictures, height, width, channels = target.shape
    if len(image) != channels or any(len(c) != pictures * height * width for c in image):
        raise DataFormatError(
            f"image has {len(image)} channels of {len(image[0])} pixels; target is "
            f"{f'{pictures} pictures of ' if pictures > 1 else ''}{width}x{height} with {channels} channels"
        )
    return dr.custom(target.moments.operation, list(image), target.moments, ssim_weight, square_weight)


class _L1SSIM(dr.CustomOp):
    def eval(self, image, target, ssim_weight, square_weight):
        self.target, self.ssim_weight = target, dr.opaque(Float, ssim_weight)
        self.square_weight = dr.opaque(Float, square_weight)
        layout = target.strip
        strip = dr.zeros(Float, layout.size)
        for k, channel in enumerate(image):
            dr.scatter(strip, Float(channel), layout.pixels(k, layout.margin), mode=dr.ReduceMode.NoConflicts)
        dr.eval(strip)
        x, y = _row_neighbours(strip), target.image
        rows = [_blur(x), _blur_product(x, x), _blur_product(x, y)]
        dr.eval(rows)
        mu, square, product = (_blur(_column_neighbours(v, layout.row)) for v in rows)
        ssim, partials = _ssim(mu, square, product, target.mu, target.square)
        self.x, self.y = _inner(strip, layout.row), _inner(y[REACH], layout.row, rows_blurred=True)
        weight = target.weight * self.ssim_weight
        terms = weight * (1 - ssim) + (target.weight - weight) * dr.abs(self.x - self.y)
        terms += target.weight * self.square_weight * dr.square(self.x - self.y)
        self.partials = [-weight * p for p in partials]
        dr.eval(terms, self.partials)
        return dr.sum(terms)

    def backward(self):
        target, upstream = self.target, Float(self.grad_out())
        dr.make_opaque(upstream)
        rows = [_blur(_row_neighbours(p)) for p in self.partials]
        dr.eval(rows)
        d_mu, d_square, d_product = (_blur(_column_neighbours(v, target.strip.row)) for v in rows)
        x, y, weight = (_inner(v, target.strip.row) for v in (self.x, self.y, target.weight))
        sign = dr.select(x > y, Float(1), dr.select(x < y, Float(-1), Float(0)))
        slope = weight * ((1 - self.ssim_weight) * sign + 2 * self.square_weight * (x - y))
        gradient = upstream * (d_mu + 2 * x * d_square + y * d_product + slope)
        dr.eval(gradient)
        out = [dr.gather(Float, gradient, target.strip.pixels(k, 0)) for k in range(target.strip.channels)]
        dr.eval(out)
        self.set_grad_in("image", out)

    def name(self):
        return "l1_ssim"


def _ssim(mu_x, square_x, product, mu_y, square_y) -> tuple[Float, list[Float]]:
    """SSIM of one window and its derivatives with respect to E[x], E[x^2], E[xy]."""
    a1, a2 = 2 * mu_x * mu_y + C1, 2 * (product - mu_x * mu_y) + C2
    b1, b2 = mu_x * mu_x + mu_y * mu_y + C1, (square_x - mu_x * mu_x) + (square_y - mu_y * mu_y) + C2
    r1, r2 = dr.rcp(b1), dr.rcp(b2)
    inverse = r1 * r2
    ssim = a1 * a2 * inverse
    d_mu = 2 * (mu_y * (a2 - a1) * inverse + mu_x * ssim * (r2 - r1))
    return ssim, [d_mu, -ssim * r2, 2 * a1 * inverse]


def _row_neighbours(strip: Float) -> list[Float]:
    """Return the 11 pixels around each place of a strip that is shorter by ALIGN at both ends."""
    return [shifted(strip, ALIGN - REACH + k, len(strip) - 2 * ALIGN) for k in range(2 * REACH + 1)]


def _column_neighbours(strip: Float, row: int) -> list[Float]:
    """Return the 11 pixels above and below each place of a strip that is shorter by REACH rows at both ends."""
    return [shifted(strip, k * row, len(strip) - 2 * REACH * row) for k in range(2 * REACH + 1)]


def _inner(strip: Float, row: int, rows_blurred: bool = False) -> Float:
    """Return a strip cut to what is left of it after a blur along rows (unless that is done) and along columns."""
    cut = REACH * row + (0 if rows_blurred else ALIGN)
    return shifted(strip, cut, len(strip) - 2 * cut)


def _blur(neighbours: list[Float]) -> Float:
    """Windowed sum of 11 neighbours; equal weights share a multiplication."""
    total = WINDOW[REACH] * neighbours[REACH]
    for k in range(REACH):
        total = dr.fma(neighbours[k] + neighbours[2 * REACH - k], WINDOW[k], total)
    return total


def _blur_product(a: list[Float], b: list[Float]) -> Float:
    total = WINDOW[REACH] * (a[REACH] * b[REACH])
    for k in range(REACH):
        j = 2 * REACH - k
        total = dr.fma(dr.fma(a[k], b[k], a[j] * b[j]), WINDOW[k], total)
    return total
