"""L1 + SSIM image loss (Kerbl et al. 2023, equation 7) as four separable passes and their analytic adjoint.

A lane blurs 8 pixels of a row, or a 4 x 8 patch of columns, from 128-bit loads. What depends only on the ground truth is
computed once per `Target`; the forward pass leaves the derivatives of SSIM with respect to the three local moments behind,
and the backward pass blurs those (the window is symmetric and zero outside, so the blur is its own adjoint).
"""

from __future__ import annotations

import drjit as dr
import numpy as np

from gof.errors import DataFormatError
from gof.render.backend import Array4f, Float, UInt, floats, frozen
from gof.render.reference import gaussian_window

C1, C2 = 0.01**2, 0.03**2
WINDOW = [float(v) for v in gaussian_window()]
REACH = 5        # the window covers 11 pixels
PATCH = 8        # outputs of one lane along the blurred axis


class Target:
    """A ground-truth image with its blurred moments.

    Args:
        image: (H, W, D) values in display range [0, 1].
        mask: (H, W) non-negative weight of every pixel in both terms; None = 1. Weights are divided by their sum.

    Raises:
        DataFormatError: shapes disagree, or the weights sum to 0.
    """

    def __init__(self, image: np.ndarray, mask: np.ndarray | None = None):
        image = np.asarray(image, np.float32)
        if image.ndim != 3:
            raise DataFormatError(f"target image has shape {image.shape}, expected (H, W, D)")
        self.height, self.width, self.channels = image.shape
        weight = np.ones(image.shape[:2]) if mask is None else np.asarray(mask, np.float64)
        if weight.shape != image.shape[:2] or not weight.sum() > 0:
            raise DataFormatError(f"target mask has shape {weight.shape} and sum {weight.sum():g}; expected {image.shape[:2]}, > 0")
        self.quads = -(-self.width // 4)
        pad = ((0, 0), (0, 4 * self.quads - self.width))
        weight = floats(np.pad(weight / (weight.sum() * self.channels), pad))
        y = floats(np.pad(image.transpose(2, 0, 1), ((0, 0), *pad)))
        self.grid = (self.channels, self.height, self.quads)
        self.arrays = (y, weight, *_blurred_moments(y, self.grid))


@frozen
def _blurred_moments(y: Float, grid: tuple) -> list[Float]:
    """Windowed E[y] and E[y^2]."""
    grid = _Grid(*grid)

    def moments(q, on):
        a = _load(y, q, on)
        return [a, [v * v for v in a]]

    rows = _blur_rows(grid, moments, 2)
    out = _empty(y, 2)

    def keep(q, on, maps):
        for plane, value in zip(out, maps, strict=True):
            _store(plane, value, q, on)
        return Float(0)

    dr.eval(_blur_columns(grid, rows, keep), out)
    return out


def l1_ssim(image: list[Float], target: Target | np.ndarray, ssim_weight: float = 0.2) -> Float:
    """(1 - w) mean |x - y| + w (1 - mean SSIM), an AD scalar.

    SSIM with an 11x11 window of sigma 1.5 px, zero beyond the border, constants for a range of 1. |x - y| has gradient 0
    where x = y. Values far outside [0, 1] lose digits in the local variances.

    Args:
        image: D planes (H * W,), row-major.
        target: a `Target`, or an (H, W, D) array (then its moments are computed every time).
    Raises:
        DataFormatError: number of channels or pixels differ.
    """
    if not isinstance(target, Target):
        target = Target(target)
    if len(image) != target.channels or any(len(c) != target.width * target.height for c in image):
        raise DataFormatError(f"image has {len(image)} channels of {len(image[0])} pixels; target is "
                              f"{target.width}x{target.height} with {target.channels} channels")
    return dr.custom(_L1SSIM, list(image), target, dr.opaque(Float, ssim_weight))


class _L1SSIM(dr.CustomOp):
    def eval(self, image, target, ssim_weight):
        self.target, self.ssim_weight = target, ssim_weight
        self.image = _stack(image, target)
        loss, self.partials = _forward(self.image, *target.arrays, ssim_weight, target.grid)
        return loss

    def backward(self):
        upstream = Float(self.grad_out())
        dr.make_opaque(upstream)
        x, weight = self.target.arrays[0], self.target.arrays[1]
        gradient = _backward(self.image, x, weight, self.partials, self.ssim_weight, upstream, self.target.grid)
        self.set_grad_in("image", _unstack(gradient, self.target))

    def name(self):
        return "l1_ssim"


@frozen
def _forward(x: Float, y: Float, weights: Float, mu: Float, square: Float, ssim_weight: Float, grid: tuple) -> tuple:
    """Loss, and its derivatives with respect to the local moments E[x], E[x^2], E[xy]."""
    grid = _Grid(*grid)

    def moments(q, on):
        a, b = _load(x, q, on), _load(y, q, on)
        return [a, [v * v for v in a], [v * w for v, w in zip(a, b, strict=True)]]

    rows = _blur_rows(grid, moments, 3)
    partial_planes = _empty(x, 3)

    def score(q, on, maps):
        total = Float(0)
        weight = _load(weights, grid.weight_quad(q), on)
        a, b, mu_y, square_y = (_load(v, q, on) for v in (x, y, mu, square))
        out = [[], [], []]
        for k in range(4):
            ssim, partials = _ssim(maps[0][k], maps[1][k], maps[2][k], mu_y[k], square_y[k])
            w = weight[k] * ssim_weight
            total += w * (1 - ssim) + (weight[k] - w) * dr.abs(a[k] - b[k])
            for column, p in zip(out, partials, strict=True):
                column.append(-w * p)
        for plane, value in zip(partial_planes, out, strict=True):
            _store(plane, value, q, on)
        return total

    lanes = _blur_columns(grid, rows, score)
    dr.eval(lanes, partial_planes)
    return dr.sum(lanes), partial_planes


@frozen
def _backward(x: Float, y: Float, weights: Float, partials: list[Float], ssim_weight: Float, upstream: Float, grid: tuple) -> Float:
    """Gradient of every stacked pixel: blurred partials chained to x, plus the sign of L1."""
    grid = _Grid(*grid)
    rows = _blur_rows(grid, lambda q, on: [_load(p, q, on) for p in partials], 3)
    gradient, = _empty(x, 1)

    def combine(q, on, maps):
        weight = _load(weights, grid.weight_quad(q), on)
        a, b = _load(x, q, on), _load(y, q, on)
        out = []
        for k in range(4):
            sign = dr.select(a[k] > b[k], Float(1), dr.select(a[k] < b[k], Float(-1), Float(0)))
            smooth = maps[0][k] + 2 * a[k] * maps[1][k] + b[k] * maps[2][k]
            out.append(upstream * (smooth + weight[k] * (1 - ssim_weight) * sign))
        _store(gradient, out, q, on)
        return Float(0)

    dr.eval(_blur_columns(grid, rows, combine), gradient)
    return gradient


def _ssim(mu_x, square_x, product, mu_y, square_y) -> tuple[Float, list[Float]]:
    """SSIM of one window and its derivatives with respect to E[x], E[x^2], E[xy]."""
    a1, a2 = 2 * mu_x * mu_y + C1, 2 * (product - mu_x * mu_y) + C2
    b1, b2 = mu_x * mu_x + mu_y * mu_y + C1, (square_x - mu_x * mu_x) + (square_y - mu_y * mu_y) + C2
    r1, r2 = dr.rcp(b1), dr.rcp(b2)
    inverse = r1 * r2
    ssim = a1 * a2 * inverse
    d_mu = 2 * (mu_y * (a2 - a1) * inverse + mu_x * ssim * (r2 - r1))
    return ssim, [d_mu, -ssim * r2, 2 * a1 * inverse]


class _Grid:
    """Lane layouts over D stacked planes whose rows are padded to whole quads of 4 pixels."""

    def __init__(self, channels: int, height: int, quads: int):
        # Python integers: Dr.Jit turns a division by a constant into a multiplication.
        self.quads, self.height = quads, height
        self.pairs, self.strips = -(-quads // 2), -(-height // PATCH)
        self.n_row_lanes = channels * height * self.pairs
        self.n_column_lanes = channels * quads * self.strips
        self.size = channels * height * quads * 4
        self.plane_quads = height * quads

    def weight_quad(self, q: UInt) -> UInt:
        """The quad of the one-channel weight plane below quad q of the stacked planes."""
        return q - (q // self.plane_quads) * self.plane_quads


def _blur_rows(grid: _Grid, read, n: int) -> list[Float]:
    """Blur along x what `read(quad, active)` makes of every quad (n lists of 4 values): n stacked planes."""
    lane = dr.arange(UInt, grid.n_row_lanes)
    row = lane // grid.pairs
    quad = (lane - row * grid.pairs) * 2
    out = [dr.empty(Float, grid.size) for _ in range(n)]
    values = [[] for _ in range(n)]
    for offset in range(-2, 4):
        q = quad + offset % (1 << 32)
        on = q < grid.quads                      # unsigned: also false left of the image
        for column, part in zip(values, read(row * grid.quads + q, on), strict=True):
            column.extend(part)
    for plane, column in zip(out, values, strict=True):
        blurred = _window_sums(column, 8 - REACH, 8)
        for half in range(2):
            _store(plane, blurred[4 * half:4 * half + 4], row * grid.quads + quad + half, quad + half < grid.quads)
    dr.eval(out)
    return out


def _blur_columns(grid: _Grid, planes: list[Float], use) -> Float:
    """Blur stacked planes along y; `use(quad, active, maps)` gets 4 blurred pixels of each and returns a value to sum."""
    lane = dr.arange(UInt, grid.n_column_lanes)
    strip = lane // grid.quads
    quad = lane - strip * grid.quads
    channel = strip // grid.strips
    top = (strip - channel * grid.strips) * PATCH
    base = channel * grid.plane_quads + quad
    columns = [[[] for _ in range(4)] for _ in planes]
    for offset in range(-REACH, PATCH + REACH):
        y = top + offset % (1 << 32)
        on = y < grid.height
        for plane, column in zip(planes, columns, strict=True):
            for k, v in enumerate(_load(plane, base + y * grid.quads, on)):
                column[k].append(v)
    blurred = [[_window_sums(column[k], 0, PATCH) for k in range(4)] for column in columns]
    total = Float(0)
    for j in range(PATCH):
        y = top + j
        maps = [[b[k][j] for k in range(4)] for b in blurred]
        total += use(base + y * grid.quads, y < grid.height, maps)
    return total


def _window_sums(values: list[Float], first: int, n: int) -> list[Float]:
    """n windowed sums of neighbouring values; the window is symmetric, so equal weights share a multiplication."""
    out = []
    for i in range(first, first + n):
        total = WINDOW[REACH] * values[i + REACH]
        for k in range(REACH):
            total = dr.fma(values[i + k] + values[i + 2 * REACH - k], WINDOW[k], total)
        out.append(total)
    return out


def _load(plane: Float, quad: UInt, active) -> list[Float]:
    return list(dr.gather(Array4f, plane, quad, active))


def _store(plane: Float, value: list[Float], quad: UInt, active) -> None:
    dr.scatter(plane, Array4f(*value), quad, active, mode=dr.ReduceMode.NoConflicts)


def _empty(like: Float, n: int) -> list[Float]:
    return [dr.empty(Float, len(like)) for _ in range(n)]


def _stack(channels: list[Float], t: Target) -> Float:
    """D planes (H * W,) to one array of planes whose rows are padded with 0 to whole quads."""
    out = dr.zeros(Float, t.channels * t.height * t.quads * 4)
    dr.make_opaque(out)
    target = _padded_index(t)
    for k, channel in enumerate(channels):
        dr.scatter(out, Float(channel), target + k * t.height * t.quads * 4, mode=dr.ReduceMode.NoConflicts)
    dr.eval(out)
    return out


def _unstack(stacked: Float, t: Target) -> list[Float]:
    source = _padded_index(t)
    out = [dr.gather(Float, stacked, source + k * t.height * t.quads * 4) for k in range(t.channels)]
    dr.eval(out)
    return out


def _padded_index(t: Target) -> UInt:
    i = dr.arange(UInt, t.width * t.height)
    return i if t.width == 4 * t.quads else i + (i // t.width) * (4 * t.quads - t.width)
