"""L1 + SSIM and its derivative in one sweep down a channel of a picture; see `gof.render.loss`.

Three stages follow each other at the distance of the window's reach: take in a row; SSIM of a row and its derivatives
with respect to three local moments, blurred along the row at once; the gradient of a row, from eleven rows of those.
Only those rows are kept, so everything but the pictures stays in the CPU's cache. They are kept twice, one ring
behind the other, and rows outside the picture as zeros: the rows of any window then lie one after the other.
"""

from __future__ import annotations

import drjit as dr
import numpy as np

from gof.render.backend import Float
from gof.render.native.compiled import kernel, part
from gof.render.native.lanes import LANES, absolute, load, ratio, spread, store, where
from gof.render.native.threads import even_parts, run, thread_count
from gof.render.ssim import C1, C2, REACH, WINDOW

SPAN = 2 * REACH + 1
W = np.array(WINDOW, np.float32)
W0, W1, W2, W3, W4, W5 = W[: REACH + 1]


@part
def _down(pictures, at, others, row, height, stride, x):
    """Windowed sums down columns [x, x + 16) of a, a^2 and a b; the window's rows of a begin at `at`, 0 outside."""
    mean = square = product = spread(np.float32(0))
    for k in range(SPAN):
        a = load(pictures, at + k * stride + x)
        weighted = a * W[k]
        mean = mean + weighted
        square = square + weighted * a
        other = min(max(row + k - REACH, 0), height - 1)
        product = product + weighted * load(others, other * stride + x)
    return mean, square, product


@part
def _along(row, x):
    """Windowed sum along a row that begins at place REACH; equal weights share a multiplication."""
    outer = (load(row, x) + load(row, x + 10)) * W0 + (load(row, x + 1) + load(row, x + 9)) * W1
    middle = (load(row, x + 2) + load(row, x + 8)) * W2 + (load(row, x + 3) + load(row, x + 7)) * W3
    return outer + middle + (load(row, x + 4) + load(row, x + 6)) * W4 + load(row, x + 5) * W5


@part
def _twice(rows, slot, ring, stride):
    """Write a row once more, a ring further on; by vectors, as a slice goes to its own array by a third place."""
    for x in range(0, stride, LANES):
        store(rows, slot + ring + x, load(rows, slot + x))


@part
def _clear(rows, slot, stride):
    for x in range(0, stride, LANES):
        store(rows, slot + x, spread(np.float32(0)))


@part
def _row_of(width):
    return np.zeros(width + 2 * REACH, np.float32)


@kernel
def moments(image, height, stride, mean, square):
    """Blurred values and squares of a channel (height, stride), whose rows end in zeros."""
    down, down_square = _row_of(stride), _row_of(stride)
    padded = np.zeros((height + 2 * REACH) * stride, np.float32)
    padded[REACH * stride : (REACH + height) * stride] = image
    for row in range(height):
        for x in range(0, stride, LANES):
            a, aa, _ = _down(padded, row * stride, image, row, height, stride, x)
            store(down, x + REACH, a)
            store(down_square, x + REACH, aa)
        for x in range(0, stride, LANES):
            store(mean, row * stride + x, _along(down, x))
            store(square, row * stride + x, _along(down_square, x))


@part
def _sum_columns(down, kept, at, truth, row, height, stride):
    """Write a row's windowed sums down the columns; the window's rows of the picture begin at `at`."""
    down_mean, down_square, down_product = down
    for x in range(0, stride, LANES):
        a, aa, ab = _down(kept, at, truth, row, height, stride, x)
        store(down_mean, x + REACH, a)
        store(down_square, x + REACH, aa)
        store(down_product, x + REACH, ab)


@part
def _derive_ssim(derivatives, down, truths, weight, weight_at, row, stride, part_ssim):
    """Write the derivatives of a row's SSIM with respect to its three moments; returns what the row costs, by lanes."""
    d_mean, d_square, d_product = derivatives
    down_mean, down_square, down_product = down
    _, truth_mean, truth_square = truths
    total = spread(np.float32(0))
    for x in range(0, stride, LANES):
        at = row * stride + x
        mu_x, mu_y, w = _along(down_mean, x), load(truth_mean, at), load(weight, weight_at + x) * part_ssim
        a1, a2 = mu_x * mu_y * 2.0 + C1, (_along(down_product, x) - mu_x * mu_y) * 2.0 + C2
        b1 = mu_x * mu_x + mu_y * mu_y + C1
        b2 = (_along(down_square, x) - mu_x * mu_x) + (load(truth_square, at) - mu_y * mu_y) + C2
        r1, r2 = ratio(np.float32(1), b1), ratio(np.float32(1), b2)
        ssim = a1 * a2 * r1 * r2
        total = total + (w - w * ssim)
        store(d_mean, x + REACH, w * -2.0 * (mu_y * (a2 - a1) * r1 * r2 + mu_x * ssim * (r2 - r1)))
        store(d_square, x + REACH, w * ssim * r2)
        store(d_product, x + REACH, w * -2.0 * a1 * r1 * r2)
    return total


@part
def _blur_along(rings, slot, derivatives, stride):
    """Write the derivatives, blurred along the row, into their rings."""
    d_mean, d_square, d_product = derivatives
    b_mean, b_square, b_product = rings
    for x in range(0, stride, LANES):
        store(b_mean, slot + x, _along(d_mean, x))
        store(b_square, slot + x, _along(d_square, x))
        store(b_product, slot + x, _along(d_product, x))


@part
def _make_gradient(line, rings, slot, truth, weight, weight_at, row, stride, part_ssim, part_square):
    """Turn a row of the picture into its gradient, whose window begins at `slot`; returns what L1 and squares cost."""
    b_mean, b_square, b_product = rings
    part_l1 = np.float32(1) - part_ssim
    total = spread(np.float32(0))
    for x in range(0, stride, LANES):
        g_mean = g_square = g_product = spread(np.float32(0))
        for k in range(SPAN):
            at = slot + k * stride + x
            g_mean = g_mean + load(b_mean, at) * W[k]
            g_square = g_square + load(b_square, at) * W[k]
            g_product = g_product + load(b_product, at) * W[k]
        a, b, w = load(line, x), load(truth, row * stride + x), load(weight, weight_at + x)
        difference = a - b
        squared = difference * part_square
        total = total + w * (absolute(difference) * part_l1 + difference * squared)
        sign = where(b < a, 1.0, where(a < b, spread(np.float32(-1)), 0.0))
        slope = w * (sign * part_l1 + squared * 2.0)
        store(line, x, g_mean + a * g_square * 2.0 + b * g_product + slope)
    return total


@part
def _added(x, lanes):
    store(lanes, 0, x)
    total = 0.0
    for k in range(LANES):
        total += lanes[k]
    return total


@kernel
def l1_ssim_rows(
    begin,
    stop,
    image,
    width,
    stride,
    truth,
    truth_mean,
    truth_square,
    weight,
    weight_stride,
    part_ssim,
    part_square,
    totals,
    gradient,
):
    """Rows [begin, stop) of a channel: add to `totals` (height,) what each costs, and write its gradient.

    image, gradient: (height * width,).  truth and its moments: (height * stride,).  weight: of each pixel, (height *
    stride,), or one row for all and weight_stride 0; 0 beyond the width.
    """
    height = len(totals)
    ring = SPAN * stride
    kept = np.zeros(2 * ring, np.float32)  # rows of the picture, then zeros
    truths = truth, truth_mean, truth_square
    down = _row_of(stride), _row_of(stride), _row_of(stride)
    derivatives = _row_of(stride), _row_of(stride), _row_of(stride)
    blurred = np.zeros((3, 2 * ring), np.float32)  # rows of those, blurred along
    rings = blurred[0], blurred[1], blurred[2]
    line, lanes = np.empty(stride, np.float32), np.empty(LANES, np.float32)
    for taken in range(max(begin - 2 * REACH, 0), stop + 2 * REACH):
        slot = taken % SPAN * stride
        if taken < height:
            kept[slot : slot + width] = image[taken * width : (taken + 1) * width]
        else:
            _clear(kept, slot, stride)
        _twice(kept, slot, ring, stride)

        row = taken - REACH
        slot = row % SPAN * stride
        if max(begin - REACH, 0) <= row < min(stop + REACH, height):
            at = (row - REACH) % SPAN * stride
            _sum_columns(down, kept, at, truth, row, height, stride)
            total = _derive_ssim(derivatives, down, truths, weight, row * weight_stride, row, stride, part_ssim)
            if begin <= row < stop:
                totals[row] += _added(total, lanes)
            _blur_along(rings, slot, derivatives, stride)
        else:
            for rows in rings:
                _clear(rows, slot, stride)
        for rows in rings:
            _twice(rows, slot, ring, stride)

        row = taken - 2 * REACH
        if begin <= row < stop:
            # The picture's row may have left its ring: it is read again.
            line[:width] = image[row * width : (row + 1) * width]
            line[width:] = 0
            slot = (row - REACH) % SPAN * stride
            total = _make_gradient(
                line, rings, slot, truth, weight, row * weight_stride, row, stride, part_ssim, part_square
            )
            totals[row] += _added(total, lanes)
            gradient[row * width : (row + 1) * width] = line[:width]


class NativeTarget:
    """Ground-truth pictures (K, H, W, D) float32, their moments, and each pixel's weight, rows padded with zeros.

    truths: those pictures, their blurred values and their blurred squares, (D, K, height * stride) each.  weight: (K,
    height * stride), or one row for all (K, stride) and weight_stride 0.
    """

    def __init__(self, image: np.ndarray, mask: np.ndarray | None):
        self.pictures, self.height, self.width, self.channels = image.shape
        self.stride = -(-self.width // LANES) * LANES
        truth = self._padded(np.moveaxis(image, -1, 0))
        self.truths = truth, np.empty_like(truth), np.empty_like(truth)
        each = zip(*(array.reshape(-1, truth.shape[-1]) for array in self.truths), strict=True)
        run(moments, [(one, self.height, self.stride, *found) for one, *found in each])
        even = np.full((self.pictures, 1, self.width), 1 / image.size)
        self.weight = self._padded(even if mask is None else mask / (np.sum(mask, dtype=np.float64) * self.channels))
        self.weight_stride = 0 if mask is None else self.stride

    @property
    def operation(self) -> type[dr.CustomOp]:
        return NativeLoss

    def parts(self) -> list[tuple[int, int, int, int]]:
        """Return channel, picture, first row and end row of each part of the work.

        Parts of one picture overlap by four times the window's reach: few of them, and where there are pictures enough
        to keep all threads busy, none.
        """
        threads = thread_count()
        split = threads if self.pictures == 1 else -(-2 * threads // (self.channels * self.pictures))
        rows = even_parts(self.height, split)
        return [(c, k, *part) for c in range(self.channels) for k in range(self.pictures) for part in rows]

    def _padded(self, rows: np.ndarray) -> np.ndarray:
        """Return (..., rows, width) as (..., rows * stride) float32, each row followed by zeros."""
        padded = np.zeros((*rows.shape[:-1], self.stride), np.float32)
        padded[..., : self.width] = rows
        return padded.reshape(*rows.shape[:-2], -1)


class NativeLoss(dr.CustomOp):
    """The gradient is found together with the value, and only scaled in the backward pass."""

    def eval(self, image, target, ssim_weight, square_weight):
        t, planes = target, [dr.detach(Float(channel)) for channel in image]
        dr.eval(planes)
        self.gradient = [dr.empty(Float, len(plane)) for plane in planes]
        drawn, gradient = ([plane.numpy().reshape(t.pictures, -1) for plane in of] for of in (planes, self.gradient))
        totals = np.zeros((t.channels, t.pictures, t.height))

        def sweep(c, k, begin, end):
            truth = *(array[c, k] for array in t.truths), t.weight[k], t.weight_stride
            weights = np.float32(ssim_weight), np.float32(square_weight)
            out = totals[c, k], gradient[c][k]
            l1_ssim_rows(begin, end, drawn[c][k], t.width, t.stride, *truth, *weights, *out)

        run(sweep, t.parts())
        return Float(float(totals.sum()))

    def backward(self):
        upstream = Float(self.grad_out())
        self.set_grad_in("image", [g * upstream for g in self.gradient])

    def name(self):
        return "native l1_ssim"
