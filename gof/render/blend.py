"""Front-to-back alpha blending and its adjoint: one Dr.Jit lane draws one 4x4 pixel block.

The 16 pixels of a block are unrolled in Python, so one fetched Gaussian serves 16 pixels and one gradient scatter
collects from 16 pixels. See docs/renderer_inside.md for the picture.
"""

from __future__ import annotations

import drjit as dr

from gof.render.backend import Array4f, Float, Int, UInt, frozen, pack, work_units
from gof.render.bins import BLOCK, LOG2_255, Bins, Lists, bin_band, footprints, plan_bands

MAX_ALPHA = 0.99  # the usual clamp: the adjoint divides by 1 - alpha >= 0.01 and loses two digits at most
MIN_TRANSMITTANCE = 1e-4  # a pixel whose transmittance would fall below this stops before that Gaussian
LN_2 = 0.6931471805599453
BLOCK_LANES = 256  # blocks that a thread takes at a time
GEOMETRY = 6  # mean_x, mean_y, a, b, c, log2_opacity
PIXELS = [(i, j) for j in range(BLOCK) for i in range(BLOCK)]  # column, row inside the block


class Trace:
    """Results of one picture for its caller; the gradient of the 2D means comes with the backward pass."""

    def __init__(self):
        self.pairs = 0  # (block, Gaussian) pairs
        self.bands = 0
        self.mean_x_grad: Float | None = None
        self.mean_y_grad: Float | None = None
        self.mean_absgrad: list[Float] | None = None  # x, y; where `absgrad` asks for it


class DrJitBlend(dr.CustomOp):
    """See `gof.render.rasterizer.blend`."""

    def eval(self, geometry, channels, projected, width, height, trace, deterministic, pair_budget, max_alpha, absgrad):
        self.shapes = shapes = footprints(projected, width, height)
        self.trace, self.deterministic, self.max_alpha, self.absgrad = trace, deterministic, max_alpha, absgrad
        self.n, self.n_channels = len(geometry[0]), len(channels)
        self.records = pack(geometry + channels, stride(len(geometry) + len(channels)))
        self.bands = plan_bands(shapes, pair_budget)
        self.planes = [
            dr.empty(Float, shapes.rows * shapes.columns * BLOCK * BLOCK) for _ in range(self.n_channels + 1)
        ]
        for band in self.bands:
            bins = bin_band(shapes, *band)
            with work_units(BLOCK_LANES):
                _forward(self.records, bins.lists, self.planes, self.n_channels, shapes.columns, max_alpha)
            trace.pairs += bins.pairs
        trace.bands = len(self.bands)
        self.bins = bins if len(self.bands) == 1 else None  # several bands: binned again in the backward pass
        return [Float(p) for p in self.planes]

    def backward(self):
        grads = [as_plane(g, len(self.planes[0])) for g in self.grad_out()]
        n_columns = GEOMETRY + self.n_channels + 2 * self.absgrad
        quads = stride(n_columns) // 4
        flat = None
        for band in self.bands:
            bins = self.bins or bin_band(self.shapes, *band)
            args = (self.records, bins.lists, self.planes, grads, self.n_channels, self.shapes.columns)
            args += self.max_alpha, self.absgrad
            if self.deterministic:
                out = dr.zeros(Float, max(bins.pairs, 1) * 4 * quads)
                with work_units(BLOCK_LANES):
                    _backward(*args, out, bins.slot)
                out = _sum_segments(out, bins, self.shapes.order, quads)
            else:
                with work_units(BLOCK_LANES):
                    out = _gradient(*args, _capacity(self.n) * 4 * quads)
            flat = out if flat is None else flat + out
            dr.eval(flat)
        lane = dr.arange(UInt, self.n) * (4 * quads)
        columns = [dr.gather(Float, flat, lane + k) for k in range(n_columns)]
        dr.eval(columns)
        hand_back(self, columns)

    def name(self):
        return "blend"


def hand_back(operation: dr.CustomOp, columns: list[Float]) -> None:
    """Gradients of geometry and channels, and perhaps absolute ones, to the inputs and the trace."""
    operation.trace.mean_x_grad, operation.trace.mean_y_grad = columns[:2]
    if operation.absgrad:
        operation.trace.mean_absgrad = [columns.pop() for _ in range(2)][::-1]
    operation.set_grad_in("geometry", columns[:GEOMETRY])
    operation.set_grad_in("channels", columns[GEOMETRY:])


def stride(n_columns: int) -> int:
    """Floats per record: 8, or a cache line, so that a record of 9 to 16 values never lies across two lines."""
    return 8 if n_columns <= 8 else 16


def _capacity(n: int) -> int:
    """n rounded up by at most a quarter. Expand-mode scatters compile the size of their target into the kernel; this
    way a set that grows in training meets four new sizes per doubling."""
    step = max(256, 1 << max(0, n.bit_length() - 3))
    return -(-n // step) * step


def _fetch(records: Float, gaussian: UInt, n_columns: int) -> list[Float]:
    quads = stride(n_columns) // 4
    used = range(-(-n_columns // 4))
    return [v for q in used for v in dr.gather(Array4f, records, gaussian * quads + q)][:n_columns]


def as_plane(gradient: Float, size: int) -> Float:
    gradient = Float(gradient) if len(gradient) == size else Float(gradient) + dr.zeros(Float, size)
    dr.make_opaque(gradient)
    return gradient


def _lanes(lists: Lists, columns: int):
    """Per lane: first and end pair of its block, centre of its first pixel, its four 4-pixel rows in a plane."""
    block = UInt(lists.order)
    start, end = dr.gather(UInt, lists.start, block), dr.gather(UInt, lists.end, block)
    by = block // columns
    bx = block - by * columns
    by += lists.first_row
    x, y = Float(bx * BLOCK) + 0.5, Float(by * BLOCK) + 0.5
    return start, end, x, y, [(by * BLOCK + j) * columns + bx for j in range(BLOCK)]


def _log2_alpha(record: list[Float], x: Float, y: Float) -> tuple[list[Float], list[Float], list[Float]]:
    """log2 alpha of the 16 pixels, and their 4 column and 4 row offsets from the mean."""
    mean_x, mean_y, a, b, c, log2_opacity = record[:GEOMETRY]
    dx, dy = [x - mean_x], [y - mean_y]
    for i in range(1, BLOCK):
        dx.append(dx[0] + i)
        dy.append(dy[0] + i)
    ax = [a * d for d in dx]
    rest = [log2_opacity - c * d * d for d in dy]
    out = [dr.fma(-dr.fma(b, dy[j], ax[i]), dx[i], rest[j]) for i, j in PIXELS]
    return out, dx, dy


def _exp2(x: Float) -> Float:
    """2^x for x in [-8, 0], relative error 2e-7; anything below -8 gives a value that the caller masks.

    Adding 1.5 * 2^23 rounds x to an integer in the low mantissa bits, which are then added to the exponent.
    """
    rounded = x + 12582912.0
    r = x - (rounded - 12582912.0)
    value = Float(0.0013333558)
    for c in (0.0096181291, 0.0555041087, 0.2402265070, 0.6931471806, 1.0):
        value = dr.fma(r, value, c)
    return dr.reinterpret_array(Float, dr.reinterpret_array(Int, value) + (dr.reinterpret_array(Int, rounded) << 23))


def _absorb(log2_alpha: Float, T: Float, max_alpha: float) -> tuple[Float, Float, Float]:
    """(alpha, 0 where the pixel does not blend it; weight T alpha; transmittance after it) for one pixel.

    The sign bit of the transmittance is set once the pixel has stopped, which saves a mask per pixel.
    """
    alpha = dr.select(log2_alpha >= -LOG2_255, dr.minimum(_exp2(log2_alpha), max_alpha), 0.0)
    before = dr.maximum(T, 0.0)
    rest = dr.fma(-before, alpha, before)
    stops = rest < MIN_TRANSMITTANCE
    alpha = dr.select(stops, 0.0, alpha)
    return alpha, before * alpha, dr.select(stops, -dr.abs(T), rest)


def _more(i: UInt, end: UInt, T: list[Float]):
    """Lanes with Gaussians left and a pixel that has not stopped."""
    largest = T[0]
    for t in T[1:]:
        largest = dr.maximum(largest, t)
    return (i < end) & (largest > 0)


@frozen
def _forward(
    records: Float, lists: Lists, planes: list[Float], n_channels: int, columns: int, max_alpha: float
) -> None:
    """Draw one band into the planes."""
    start, end, x, y, plane_rows = _lanes(lists, columns)

    def step(i, T, acc):
        record = _fetch(records, dr.gather(UInt, lists.gaussian, i), GEOMETRY + n_channels)
        log2_alpha, _, _ = _log2_alpha(record, x, y)
        T_out, acc_out = [], [[] for _ in range(n_channels)]
        for k in range(16):
            _, w, rest = _absorb(log2_alpha[k], T[k], max_alpha)
            T_out.append(rest)
            for ch in range(n_channels):
                acc_out[ch].append(dr.fma(w, record[GEOMETRY + ch], acc[ch][k]))
        return i + 1, T_out, acc_out

    T = [Float(1) for _ in range(16)]
    acc = [[Float(0) for _ in range(16)] for _ in range(n_channels)]
    _, T, acc = dr.while_loop((UInt(start), T, acc), lambda i, T, acc: _more(i, end, T), step, labels=("i", "T", "acc"))

    values = [*acc, [1 - dr.abs(t) for t in T]]
    for plane, value in zip(planes, values, strict=True):
        for j in range(BLOCK):
            dr.scatter(plane, Array4f(*value[4 * j : 4 * j + 4]), plane_rows[j], mode=dr.ReduceMode.NoConflicts)
    dr.eval(planes)


@frozen
def _gradient(
    records: Float,
    lists: Lists,
    planes: list[Float],
    grads: list[Float],
    n_channels: int,
    columns: int,
    max_alpha: float,
    absgrad: bool,
    size: int,
) -> Float:
    """Gradient records per Gaussian, summed in any order. `size` is compiled into expand-mode scatters."""
    out = dr.zeros(Float, size)
    _backward(records, lists, planes, grads, n_channels, columns, max_alpha, absgrad, out, None)
    return out


def _backward(
    records: Float,
    lists: Lists,
    planes: list[Float],
    grads: list[Float],
    n_channels: int,
    columns: int,
    max_alpha: float,
    absgrad: bool,
    out: Float,
    slot: UInt | None,
) -> None:
    """Add one band's gradient records to `out` per Gaussian, or with `slot` write them per pair, Gaussian-major.

    Replays the forward pass front to back. With v_i = sum_c g_c channel_ic + g_alpha and S_i = sum_{k > i} w_k v_k:
    dL/dalpha_i = T_i v_i - S_i / (1 - alpha_i). S starts at the whole sum, known from the forward planes, and shrinks
    by w_i v_i. Nothing divides by T or by opacity.
    """
    start, end, x, y, plane_rows = _lanes(lists, columns)
    n_columns = GEOMETRY + n_channels
    quads = stride(n_columns + 2 * absgrad) // 4

    def load(plane):
        return [v for r in plane_rows for v in dr.gather(Array4f, plane, r)]

    g = [load(p) for p in grads]  # per channel, then alpha; 16 pixels each
    totals = [load(p) for p in planes]
    suffix = [sum(g[ch][k] * totals[ch][k] for ch in range(n_channels + 1)) for k in range(16)]

    def step(i, T, S):
        gaussian = dr.gather(UInt, lists.gaussian, i)
        record = _fetch(records, gaussian, n_columns)
        log2_alpha, dx, dy = _log2_alpha(record, x, y)
        T_out, S_out, d_log2 = [], [], []
        d_channel = [Float(0) for _ in range(n_channels)]
        for k in range(16):
            alpha, w, rest = _absorb(log2_alpha[k], T[k], max_alpha)
            v = g[n_channels][k]
            for ch in range(n_channels):
                v = dr.fma(g[ch][k], record[GEOMETRY + ch], v)
                d_channel[ch] = dr.fma(w, g[ch][k], d_channel[ch])
            wv = w * v
            s = S[k] - wv
            # alpha dL/dalpha; 0 where alpha is 0 without a mask, and by choice where alpha was clamped.
            d_log2.append(dr.select(alpha < max_alpha, dr.fma(-s, alpha * dr.rcp(1 - alpha), wv), 0.0))
            T_out.append(rest)
            S_out.append(s)
        gradient = _geometry_gradient(record, dx, dy, d_log2) + d_channel
        if absgrad:
            gradient += _absolute_mean_gradient(record, dx, dy, d_log2)
        gradient += [Float(0)] * (-len(gradient) % 4)
        for q in range(len(gradient) // 4):
            value = Array4f(*gradient[4 * q : 4 * q + 4])
            if slot is not None:
                dr.scatter(out, value, dr.gather(UInt, slot, i) * quads + q, mode=dr.ReduceMode.NoConflicts)
            else:
                dr.scatter_add(out, value, gaussian * quads + q, mode=dr.ReduceMode.Expand)
        return i + 1, T_out, S_out

    T = [Float(1) for _ in range(16)]
    dr.while_loop((UInt(start), T, suffix), lambda i, T, S: _more(i, end, T), step, labels=("i", "T", "S"))
    dr.eval(out)


def _sum_segments(by_pair: Float, bins: Bins, order: UInt, quads: int) -> Float:
    """Per-pair records to per-Gaussian records, each summed in a fixed order."""
    out = dr.empty(Float, len(order) * 4 * quads)

    def add(i, total):
        values = [v for q in range(quads) for v in dr.gather(Array4f, by_pair, i * quads + q)]
        return i + 1, [t + v for t, v in zip(total, values, strict=True)]

    total = [Float(0) for _ in range(4 * quads)]
    _, total = dr.while_loop((UInt(bins.segment), total), lambda i, total: i < bins.segment_end, add)
    for q in range(quads):
        dr.scatter(out, Array4f(*total[4 * q : 4 * q + 4]), order * quads + q, mode=dr.ReduceMode.NoConflicts)
    dr.eval(out)
    return out


def _geometry_gradient(record: list[Float], dx: list[Float], dy: list[Float], d_log2: list[Float]) -> list[Float]:
    """Chain dL/d(log2 alpha) of 16 pixels (in units of ln 2) to mean, a, b, c and log2_opacity through its moments."""
    per_row = [d_log2[4 * j : 4 * j + 4] for j in range(BLOCK)]
    sums = [r[0] + r[1] + r[2] + r[3] for r in per_row]
    m0 = (sums[0] + sums[1]) + (sums[2] + sums[3])
    m_y, m_yy, m_x, m_xx, m_xy = (Float(0) for _ in range(5))
    for j in range(BLOCK):
        d = per_row[j]
        along = dr.fma(d[0], dx[0], d[1] * dx[1]) + dr.fma(d[2], dx[2], d[3] * dx[3])
        m_x += along
        m_xy = dr.fma(along, dy[j], m_xy)
        weighted = sums[j] * dy[j]
        m_y += weighted
        m_yy = dr.fma(weighted, dy[j], m_yy)
    for i in range(BLOCK):
        column = (per_row[0][i] + per_row[1][i]) + (per_row[2][i] + per_row[3][i])
        m_xx = dr.fma(column * dx[i], dx[i], m_xx)
    a, b, c = record[2:5]
    return [v * LN_2 for v in (2 * a * m_x + b * m_y, 2 * c * m_y + b * m_x, -m_xx, -m_xy, -m_yy, m0)]


def _absolute_mean_gradient(record: list[Float], dx: list[Float], dy: list[Float], d_log2: list[Float]) -> list[Float]:
    """Sum over 16 pixels of |dL/d(mean)| of each, x and y; args as `_geometry_gradient`."""
    a, b, c = record[2:5]
    total_x, total_y = Float(0), Float(0)
    for (i, j), d in zip(PIXELS, d_log2, strict=True):
        total_x += dr.abs(d * dr.fma(2 * a, dx[i], b * dy[j]))
        total_y += dr.abs(d * dr.fma(2 * c, dy[j], b * dx[i]))
    return [total_x * LN_2, total_y * LN_2]
