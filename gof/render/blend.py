"""Front-to-back alpha blending and its adjoint: on a CPU one Dr.Jit lane draws one 4x4 pixel block.

The 16 pixels of a block are unrolled in Python, so one fetched Gaussian serves 16 pixels and one gradient scatter
collects from 16 pixels. See docs/renderer_inside.md for the picture. A GPU has more lanes than a picture has blocks,
and waits for the longest list: there a lane draws four pixels (`SHARE`) and fetches the next Gaussian meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr

from gof.render.backend import BACKEND, Array4f, Float, Int, UInt, frozen, pack, work_units
from gof.render.bins import BLOCK, LOG2_255, Bins, Lists, bin_band, footprints, plan_bands

MAX_ALPHA = 0.99  # the usual clamp: the adjoint divides by 1 - alpha >= 0.01 and loses two digits at most
MIN_TRANSMITTANCE = 1e-4  # a pixel whose transmittance would fall below this stops before that Gaussian
LN_2 = 0.6931471805599453
BLOCK_LANES = 256  # blocks that a thread takes at a time
GEOMETRY = 6  # mean_x, mean_y, a, b, c, log2_opacity
# Many lanes add to one Gaussian: on a CPU each thread to a copy of its own. On a GPU one by one, four floats at a time;
# Dr.Jit takes them singly there where it has to make copies.
ADDED = dr.ReduceMode.Direct if BACKEND == "cuda" else dr.ReduceMode.Expand


@dataclass(frozen=True)
class Share:
    """The pixels of a block that one lane draws: `across` (4 or 1) side by side, in `down` rows."""

    across: int
    down: int

    @property
    def pixels(self) -> list[tuple[int, int]]:
        """Column and row of each."""
        return [(i, j) for j in range(self.down) for i in range(self.across)]

    @property
    def lanes(self) -> int:
        """Lanes that share a block."""
        return BLOCK * BLOCK // (self.across * self.down)


WHOLE = Share(BLOCK, BLOCK)
SHARE = Share(4, 1) if BACKEND == "cuda" else WHOLE


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

    def eval(self, geometry, channels, projected, canvas, trace, deterministic, pair_budget, max_alpha, absgrad):
        self.shapes = shapes = footprints(projected, canvas)
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
                lists = shared(bins.lists, SHARE)
                _forward(self.records, lists, self.planes, self.n_channels, shapes.columns, max_alpha, SHARE)
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
            share = WHOLE if self.deterministic else SHARE  # of a pair that several lanes share the order is unknown
            args = (self.records, shared(bins.lists, share), self.planes, grads, self.n_channels, self.shapes.columns)
            args += self.max_alpha, self.absgrad, share
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


def shared(lists: Lists, share: Share) -> Lists:
    """Return lists whose `order` has a number for every lane, its block times `share.lanes` plus its part of it."""
    if share == WHOLE:
        return lists
    lane = dr.arange(UInt, share.lanes * len(lists.order))
    order = dr.gather(UInt, lists.order, lane // share.lanes) * share.lanes + lane % share.lanes
    dr.eval(order)
    return replace(lists, order=order)


def _lanes(lists: Lists, columns: int, share: Share):
    """Per lane: first and end pair of its block, centre of its first pixel, where in a plane its rows begin.

    Places in a plane are counted in `share.across` pixels.
    """
    lane = UInt(lists.order)
    block = lane if share == WHOLE else lane // share.lanes
    start, end = dr.gather(UInt, lists.start, block), dr.gather(UInt, lists.end, block)
    by = block // columns
    bx = block - by * columns
    by += lists.first_row
    left, top = bx * BLOCK, by * BLOCK
    if share != WHOLE:
        part, in_a_row = lane - block * share.lanes, BLOCK // share.across
        left += part % in_a_row * share.across
        top += part // in_a_row * share.down
    x, y = Float(left) + 0.5, Float(top) + 0.5
    rows = [(top + j) * columns + bx for j in range(share.down)]
    return start, end, x, y, rows if share.across == BLOCK else [row * BLOCK + (left - bx * BLOCK) for row in rows]


def _read(plane: Float, rows: list[UInt], share: Share) -> list[Float]:
    """Values of a lane's pixels."""
    if share.across == 1:
        return [dr.gather(Float, plane, row) for row in rows]
    return [v for row in rows for v in dr.gather(Array4f, plane, row)]


def _write(plane: Float, values: list[Float], rows: list[UInt], share: Share) -> None:
    for j, row in enumerate(rows):
        one_row = values[share.across * j : share.across * (j + 1)]
        value = one_row[0] if share.across == 1 else Array4f(*one_row)
        dr.scatter(plane, value, row, mode=dr.ReduceMode.NoConflicts)


def _walk(
    lists: Lists,
    records: Float,
    n_columns: int,
    start: UInt,
    end: UInt,
    share: Share,
    state: tuple[list, ...],
    step: Callable,
) -> tuple[list, ...]:
    """Take the Gaussians of each lane's list in turn, until it ends or all the lane's pixels have stopped.

    Args:
        state: of the walk; the first are the transmittances.
        step: (place in the lists, Gaussian, its record, *state) -> the state after it.
    """
    if share == WHOLE:

        def take(i, *state):
            gaussian = dr.gather(UInt, lists.gaussian, i)
            return i + 1, *step(i, gaussian, _fetch(records, gaussian, n_columns), *state)

        return dr.while_loop((UInt(start), *state), lambda i, T, *_: _more(i, end, T), take)[1:]

    # Each fetch is used a turn later: nothing else hides the latency of a GPU's memory from so few lanes.
    def take_and_fetch(i, gaussian, record, following, *state):
        next_record = _fetch(records, following, n_columns)
        after = dr.gather(UInt, lists.gaussian, i + 2, i + 2 < end)
        return i + 1, following, next_record, after, *step(i, gaussian, record, *state)

    first = dr.gather(UInt, lists.gaussian, start, start < end)
    second = dr.gather(UInt, lists.gaussian, start + 1, start + 1 < end)
    ahead = UInt(start), first, _fetch(records, first, n_columns), second
    return dr.while_loop((*ahead, *state), lambda i, _g, _r, _f, T, *_: _more(i, end, T), take_and_fetch)[4:]


def _log2_alpha(record: list[Float], x: Float, y: Float, share: Share) -> tuple[list[Float], list[Float], list[Float]]:
    """log2 alpha of a lane's pixels, and the offsets of their columns and rows from the mean."""
    mean_x, mean_y, a, b, c, log2_opacity = record[:GEOMETRY]
    dx, dy = [x - mean_x], [y - mean_y]
    dx += [dx[0] + i for i in range(1, share.across)]
    dy += [dy[0] + j for j in range(1, share.down)]
    ax = [a * d for d in dx]
    rest = [log2_opacity - c * d * d for d in dy]
    out = [dr.fma(-dr.fma(b, dy[j], ax[i]), dx[i], rest[j]) for i, j in share.pixels]
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
    records: Float,
    lists: Lists,
    planes: list[Float],
    n_channels: int,
    columns: int,
    max_alpha: float,
    share: Share,
) -> None:
    """Draw one band into the planes; `lists` are `shared`."""
    start, end, x, y, rows = _lanes(lists, columns, share)
    count = len(share.pixels)

    def step(_i, _gaussian, record, T, acc):
        log2_alpha, _, _ = _log2_alpha(record, x, y, share)
        T_out, acc_out = [], [[] for _ in range(n_channels)]
        for k in range(count):
            _, w, rest = _absorb(log2_alpha[k], T[k], max_alpha)
            T_out.append(rest)
            for ch in range(n_channels):
                acc_out[ch].append(dr.fma(w, record[GEOMETRY + ch], acc[ch][k]))
        return T_out, acc_out

    T = [Float(1) for _ in range(count)]
    acc = [[Float(0) for _ in range(count)] for _ in range(n_channels)]
    T, acc = _walk(lists, records, GEOMETRY + n_channels, start, end, share, (T, acc), step)

    values = [*acc, [1 - dr.abs(t) for t in T]]
    for plane, value in zip(planes, values, strict=True):
        _write(plane, value, rows, share)
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
    share: Share,
    size: int,
) -> Float:
    """Gradient records per Gaussian, summed in any order. `size` is compiled into expand-mode scatters."""
    out = dr.zeros(Float, size)
    _backward(records, lists, planes, grads, n_channels, columns, max_alpha, absgrad, share, out, None)
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
    share: Share,
    out: Float,
    slot: UInt | None,
) -> None:
    """Add one band's gradient records to `out` per Gaussian, or with `slot` write them per pair, Gaussian-major.

    `lists` are `shared`; with `slot` a lane has the whole block.

    Replays the forward pass front to back. With v_i = sum_c g_c channel_ic + g_alpha and S_i = sum_{k > i} w_k v_k:
    dL/dalpha_i = T_i v_i - S_i / (1 - alpha_i). S starts at the whole sum, known from the forward planes, and shrinks
    by w_i v_i. Nothing divides by T or by opacity.
    """
    start, end, x, y, rows = _lanes(lists, columns, share)
    n_columns = GEOMETRY + n_channels
    quads = stride(n_columns + 2 * absgrad) // 4
    count = len(share.pixels)

    g = [_read(p, rows, share) for p in grads]  # per channel, then alpha
    totals = [_read(p, rows, share) for p in planes]
    suffix = [sum(g[ch][k] * totals[ch][k] for ch in range(n_channels + 1)) for k in range(count)]

    def step(i, gaussian, record, T, S):
        log2_alpha, dx, dy = _log2_alpha(record, x, y, share)
        T_out, S_out, d_log2 = [], [], []
        d_channel = [Float(0) for _ in range(n_channels)]
        for k in range(count):
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
            gradient += _absolute_mean_gradient(record, dx, dy, d_log2, share)
        gradient += [Float(0)] * (-len(gradient) % 4)
        for q in range(len(gradient) // 4):
            value = Array4f(*gradient[4 * q : 4 * q + 4])
            if slot is not None:
                dr.scatter(out, value, dr.gather(UInt, slot, i) * quads + q, mode=dr.ReduceMode.NoConflicts)
            else:
                dr.scatter_add(out, value, gaussian * quads + q, mode=ADDED)
        return T_out, S_out

    T = [Float(1) for _ in range(count)]
    _walk(lists, records, n_columns, start, end, share, (T, suffix), step)
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
    """Chain dL/d(log2 alpha) of a lane's pixels (in units of ln 2) to mean, conic and opacity through its moments."""
    across = len(dx)
    per_row = [d_log2[across * j : across * (j + 1)] for j in range(len(dy))]
    sums = [sum(r[1:], r[0]) for r in per_row]
    m0 = _paired(sums)
    m_y, m_yy, m_x, m_xx, m_xy = (Float(0) for _ in range(5))
    for j, d in enumerate(per_row):
        along = _dot(d, dx)
        m_x += along
        m_xy = dr.fma(along, dy[j], m_xy)
        weighted = sums[j] * dy[j]
        m_y += weighted
        m_yy = dr.fma(weighted, dy[j], m_yy)
    for i in range(across):
        column = _paired([row[i] for row in per_row])
        m_xx = dr.fma(column * dx[i], dx[i], m_xx)
    a, b, c = record[2:5]
    return [v * LN_2 for v in (2 * a * m_x + b * m_y, 2 * c * m_y + b * m_x, -m_xx, -m_xy, -m_yy, m0)]


def _paired(values: list[Float]) -> Float:
    """Return the sum of four, or of one."""
    return values[0] if len(values) == 1 else (values[0] + values[1]) + (values[2] + values[3])


def _dot(a: list[Float], b: list[Float]) -> Float:
    """Return the scalar product of four, or of one."""
    if len(a) == 1:
        return a[0] * b[0]
    return dr.fma(a[0], b[0], a[1] * b[1]) + dr.fma(a[2], b[2], a[3] * b[3])


def _absolute_mean_gradient(
    record: list[Float], dx: list[Float], dy: list[Float], d_log2: list[Float], share: Share
) -> list[Float]:
    """Sum over a lane's pixels of |dL/d(mean)| of each, x and y; args as `_geometry_gradient`."""
    a, b, c = record[2:5]
    total_x, total_y = Float(0), Float(0)
    for (i, j), d in zip(share.pixels, d_log2, strict=True):
        total_x += dr.abs(d * dr.fma(2 * a, dx[i], b * dy[j]))
        total_y += dr.abs(d * dr.fma(2 * c, dy[j], b * dx[i]))
    return [total_x * LN_2, total_y * LN_2]
