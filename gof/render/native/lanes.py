"""Sixteen float32 as one value in numba: LLVM's `<16 x float>`.

It is one register with AVX-512, two with AVX2 and four with NEON; LLVM splits it, from one source. Loops over 16
pixels would have to be vectorised by LLVM, which gives up at the first branch and keeps what they carry in memory (3 to
18 times slower here). Lane 4 j + i is the pixel in column i and row j of a 4x4 block.

Operators work lane by lane; a number beside a vector stands for itself in every lane. Indices are not checked.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, overload, register_model

from gof.render.native.compiled import FAST, part

LANES = 16
F32, I32 = ir.FloatType(), ir.IntType(32)
VECTOR, INTEGERS, QUAD = ir.VectorType(F32, LANES), ir.VectorType(I32, LANES), ir.VectorType(F32, 4)
FLAGS = tuple(sorted(FAST))


class _LaneType(types.Type):
    """16 floats, or 16 truth values."""


vector, mask = _LaneType("lanes"), _LaneType("mask")


@register_model(_LaneType)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, VECTOR if kind is vector else ir.VectorType(ir.IntType(1), LANES))


# ---------------------------------------------------------------- lane by lane


def _use_wide_registers(builder) -> None:
    """Many CPUs have 512-bit registers that LLVM uses only on request."""
    for attribute in ('"prefer-vector-width"="512"', '"min-legal-vector-width"="512"'):
        set.add(builder.function.attributes, attribute)  # llvmlite's own `add` knows a few attributes only


def _spread(builder, number):
    """Return a number in every lane."""
    undefined = ir.Constant(VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(I32, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(INTEGERS, [0] * LANES))


def _constant(values) -> ir.Constant:
    return ir.Constant(VECTOR, [ir.Constant(F32, float(v)) for v in values])


def _vectors(context, builder, kinds, values) -> list:
    """Return the operands as vectors (a mask stays one)."""
    _use_wide_registers(builder)
    return [
        value if isinstance(kind, _LaneType) else _spread(builder, context.cast(builder, value, kind, types.float32))
        for kind, value in zip(kinds, values, strict=True)
    ]


def _lanewise(build, operands: int, result=vector):
    """Return an intrinsic: `build(builder, *vectors)` on vectors and numbers, of which one at least is a vector."""

    def signature(*kinds):
        def emit(context, builder, signature, values):
            return build(builder, *_vectors(context, builder, signature.args, values))

        return result(*kinds), emit

    if operands == 1:

        @intrinsic
        def one(typing, x):
            return signature(x)

        return one
    if operands == 2:

        @intrinsic
        def two(typing, x, y):
            return signature(x, y)

        return two

    @intrinsic
    def three(typing, x, y, z):
        return signature(x, y, z)

    return three


def _library(name: str):
    """LLVM's own function of a vector."""

    def build(builder, x):
        kind = ir.FunctionType(VECTOR, [VECTOR])
        full = f"llvm.{name}.v16f32"
        return builder.call(builder.module.globals.get(full) or ir.Function(builder.module, kind, full), [x])

    return build


def _choose(compare: str):
    return lambda b, x, y: b.select(b.fcmp_ordered(compare, x, y), x, y)


spread = _lanewise(lambda b, x: x, 1)
minimum = _lanewise(_choose("<"), 2)
maximum = _lanewise(_choose(">"), 2)
where = _lanewise(lambda b, condition, x, y: b.select(condition, x, y), 3)
square_root, floor, ceil = (_lanewise(_library(name), 1) for name in ("sqrt", "floor", "ceil"))
absolute = _lanewise(_library("fabs"), 1)
# By estimate and one Newton step where the CPU has them: 1e-7 relative, infinite or NaN where y is 0.
ratio = _lanewise(lambda b, x, y: b.fdiv(x, y, flags=("fast",)), 2)
some = _lanewise(
    lambda b, x: b.icmp_unsigned("!=", b.bitcast(x, ir.IntType(LANES)), ir.Constant(ir.IntType(LANES), 0)),
    1,
    types.boolean,
)
_raise_exponent = _lanewise(
    lambda b, x, n: b.bitcast(
        b.add(b.bitcast(x, INTEGERS), b.shl(b.bitcast(n, INTEGERS), ir.Constant(INTEGERS, [23] * LANES))), VECTOR
    ),
    2,
)


def _operator(python, build, result=vector):
    compiled = _lanewise(build, 2, result)

    @overload(python)
    def operate(x, y):
        if vector in (x, y):
            return lambda x, y: compiled(x, y)


_operator(operator.add, lambda b, x, y: b.fadd(x, y, flags=FLAGS))
_operator(operator.sub, lambda b, x, y: b.fsub(x, y, flags=FLAGS))
_operator(operator.mul, lambda b, x, y: b.fmul(x, y, flags=FLAGS))
_operator(operator.ge, lambda b, x, y: b.fcmp_ordered(">=", x, y), mask)
_operator(operator.lt, lambda b, x, y: b.fcmp_ordered("<", x, y), mask)


@part
def exp2(x):
    """2^x for x in [-8, 0], relative error 2e-7; anything below -8 gives a value that the caller masks.

    Adding 1.5 * 2^23 rounds x to an integer in the low mantissa bits, which are then added to the exponent.
    """
    rounded = x + 12582912.0
    r = x - (rounded - 12582912.0)
    value = ((((0.0013333558 * r + 0.0096181291) * r + 0.0555041087) * r + 0.2402265070) * r + 0.6931471806) * r + 1.0
    return _raise_exponent(value, rounded)


@intrinsic
def block_columns(typing):
    """0 1 2 3, 0 1 2 3, ...: the column of each lane in its block."""
    return vector(), lambda context, builder, signature, values: _constant(k % 4 for k in range(LANES))


@intrinsic
def block_rows(typing):
    """0 0 0 0, 1 1 1 1, ...: the row of each lane in its block."""
    return vector(), lambda context, builder, signature, values: _constant(k // 4 for k in range(LANES))


@intrinsic
def row_numbers(typing):
    """0 1 2 ... 15."""
    return vector(), lambda context, builder, signature, values: _constant(range(LANES))


@intrinsic
def exchange(typing, x, distance):
    """Lane k gets lane k ^ distance (1, 2, 4 or 8, a literal)."""
    if not isinstance(distance, types.IntegerLiteral):
        return None
    lanes = [k ^ distance.literal_value for k in range(LANES)]
    return vector(x, distance), lambda context, builder, signature, values: _shuffle(builder, values[0], lanes)


def _shuffle(builder, x, lanes, y=None):
    """Lanes of x, and of y from 16 on."""
    lanes = ir.Constant(ir.VectorType(I32, len(lanes)), list(lanes))
    return builder.shuffle_vector(x, ir.Constant(x.type, ir.Undefined) if y is None else y, lanes)


# ---------------------------------------------------------------- memory


def _pointer(context, builder, kind, array, index):
    return builder.gep(context.make_array(kind)(context, builder, array).data, [index])


def _constant_load(builder, pointer):
    """LLVM may read it later, where it is needed, because no store to another array changes it."""
    value = builder.load(pointer)
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


def _load(builder, pointer, kind):
    return builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4, typ=kind)


def _store(builder, pointer, value):
    builder.store(value, builder.bitcast(pointer, value.type.as_pointer()), align=4)


@intrinsic
def get(typing, array, index):
    """array[index] of an array that the kernel only reads."""

    def emit(context, builder, signature, values):
        return _constant_load(builder, _pointer(context, builder, signature.args[0], *values))

    return array.dtype(array, types.int64), emit


@intrinsic
def load(typing, array, index):
    """array[index : index + 16]."""

    def emit(context, builder, signature, values):
        _use_wide_registers(builder)
        return _load(builder, _pointer(context, builder, signature.args[0], *values), VECTOR)

    return vector(array, types.int64), emit


@intrinsic
def store(typing, array, index, x):
    """array[index : index + 16] = x."""

    def emit(context, builder, signature, values):
        _store(builder, _pointer(context, builder, signature.args[0], *values[:2]), values[2])
        return context.get_dummy_value()

    return types.void(array, types.int64, x), emit


@intrinsic
def store_words(typing, array, index, low, high):
    """array[index : index + 16] = low | high << 16, of whole numbers from 0 to 65535; an array of uint32."""

    def emit(context, builder, signature, values):
        low, high = (builder.fptosi(x, INTEGERS) for x in values[2:])
        words = builder.or_(low, builder.shl(high, ir.Constant(INTEGERS, [16] * LANES)))
        _store(builder, _pointer(context, builder, signature.args[0], *values[:2]), words)
        return context.get_dummy_value()

    return types.void(array, types.int64, low, high), emit


@intrinsic
def prefetch(typing, array, index):
    """Ask for array[index], which will be wanted soon."""

    def emit(context, builder, signature, values):
        pointer = _pointer(context, builder, signature.args[0], *values)
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, I32, I32, I32])
        name = "llvm.prefetch.p0"
        function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        builder.call(function, [pointer, *(ir.Constant(I32, v) for v in (0, 3, 1))])  # read, keep, data
        return context.get_dummy_value()

    return types.void(array, types.int64), emit


@intrinsic
def take_next(typing, counter):
    """counter[0] += 1 by one thread at a time, of those that share it; returns what it was before."""

    def emit(context, builder, signature, values):
        pointer = _pointer(context, builder, signature.args[0], values[0], ir.Constant(ir.IntType(64), 0))
        return builder.atomic_rmw("add", pointer, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), emit


def _block_rows(context, builder, kind, plane, index, stride):
    """Addresses of a block's four rows."""
    for _ in range(4):
        yield _pointer(context, builder, kind, plane, index)
        index = builder.add(index, stride)


# ---------------------------------------------------------------- one value per plane or channel


def _elements(builder, tuple_):
    return [builder.extract_value(tuple_, k) for k in range(tuple_.type.count)]


def _tuple_of(context, builder, kind, values):
    return context.make_tuple(builder, kind, values)


@intrinsic
def zeros(typing, planes):
    """Return a tuple of zeros, one for each."""
    kind = types.UniTuple(vector, len(planes))

    def emit(context, builder, signature, values):
        return _tuple_of(context, builder, kind, [_constant([0] * LANES)] * len(kind))

    return kind(planes), emit


@intrinsic
def load_blocks(typing, planes, index, stride):
    """Return the 4x4 block that begins at `index` of each plane with `stride` values per row."""
    kind = types.UniTuple(vector, len(planes))

    def emit(context, builder, signature, values):
        _use_wide_registers(builder)
        out = []
        for plane in _elements(builder, values[0]):
            pointers = _block_rows(context, builder, signature.args[0].dtype, plane, *values[1:])
            a, b, c, d = (_load(builder, pointer, QUAD) for pointer in pointers)
            top, bottom = _shuffle(builder, a, range(8), b), _shuffle(builder, c, range(8), d)
            out.append(_shuffle(builder, top, range(LANES), bottom))
        return _tuple_of(context, builder, kind, out)

    return kind(planes, types.int64, types.int64), emit


@intrinsic
def store_blocks(typing, planes, index, stride, blocks):
    """Do the reverse of `load_blocks`."""

    def emit(context, builder, signature, values):
        for plane, block in zip(_elements(builder, values[0]), _elements(builder, values[3]), strict=True):
            pointers = _block_rows(context, builder, signature.args[0].dtype, plane, *values[1:3])
            for row, pointer in enumerate(pointers):
                _store(builder, pointer, _shuffle(builder, block, range(4 * row, 4 * row + 4)))
        return context.get_dummy_value()

    return types.void(planes, types.int64, types.int64, blocks), emit


@intrinsic
def scaled(typing, blocks, factor):
    """Each times the factor."""

    def emit(context, builder, signature, values):
        products = [builder.fmul(block, values[1], flags=FLAGS) for block in _elements(builder, values[0])]
        return _tuple_of(context, builder, blocks, products)

    return blocks(blocks, vector), emit


@intrinsic
def add_weighted(typing, blocks, weight, array, index):
    """blocks[k] + weight * array[index + k]."""

    def emit(context, builder, signature, values):
        out = []
        for block, number in zip(*_with_numbers(context, builder, signature.args[2], *_three(values)), strict=True):
            out.append(builder.fadd(block, builder.fmul(values[1], number, flags=FLAGS), flags=FLAGS))
        return _tuple_of(context, builder, blocks, out)

    return blocks(blocks, vector, array, types.int64), emit


def _three(values):
    return values[0], values[2], values[3]


def _with_numbers(context, builder, kind, blocks, array, index):
    """Return the blocks, and for each the number at its place in the array."""
    blocks = _elements(builder, blocks)
    pointers = (
        _pointer(context, builder, kind, array, builder.add(index, ir.Constant(index.type, k)))
        for k in range(len(blocks))
    )
    return blocks, [_spread(builder, _constant_load(builder, pointer)) for pointer in pointers]


@intrinsic
def weighted_sum(typing, blocks, array, index, start):
    """start + sum_k blocks[k] array[index + k]."""

    def emit(context, builder, signature, values):
        total = values[3]
        for block, number in zip(*_with_numbers(context, builder, signature.args[1], *values[:3]), strict=True):
            total = builder.fadd(builder.fmul(block, number, flags=FLAGS), total, flags=FLAGS)
        return total

    return vector(blocks, array, types.int64, vector), emit


@intrinsic
def inner_product(typing, blocks, others):
    """sum_k blocks[k] others[k]."""

    def emit(context, builder, signature, values):
        total = _constant([0] * LANES)
        for x, y in zip(*(_elements(builder, value) for value in values), strict=True):
            total = builder.fadd(builder.fmul(x, y, flags=FLAGS), total, flags=FLAGS)
        return total

    return vector(blocks, others), emit


# ---------------------------------------------------------------- sums over a block

MOMENTS = {"1": 0, "x": 1, "xx": 2, "y": 4, "xy": 5, "yy": 8}  # lane of `block_sums` with sum d, sum d dx, ...
PLAIN = (12, 3, 7, 11, 15, 9, 13, 6, 10, 14)  # lanes with the sums of the other blocks


@intrinsic
def block_sums(typing, d, dx, dy, others):
    """Sum over the 16 pixels d times 1, dx, dx^2, dy, dx dy, dy^2, and up to ten other blocks; one sum per lane.

    dx must be the same in every row, so rows are summed before anything is multiplied by it: four blocks fold into one
    whose four quads hold the sums of their columns.
    """

    def emit(context, builder, signature, values):
        _use_wide_registers(builder)
        d, dx, dy, others = values
        fold = _Folding(builder)
        plain = [*_elements(builder, others), *[None] * 10][:10] if len(signature.args[3]) else [None] * 10
        d_dy = fold.times(d, dy)
        first = fold.rows(d, d_dy, fold.times(d_dy, dy), plain[0])
        second = fold.times(first, dx)  # its quads 0 and 1 are moments; 2 and 3 are free for others
        third = fold.times(second, dx)  # quad 0 is a moment
        fourth = fold.rows(*plain[1:5])
        second = fold.replaced(second, 8, fold.rows(None, None, *plain[5:7]))
        third = fold.replaced(third, 4, fold.rows(None, *plain[7:10]))
        return fold.columns(first, second, third, fourth)

    return vector(d, dx, dy, others), emit


@intrinsic
def store_plain_sums(typing, arrays, index, sums):
    """arrays[k][index] = sums[PLAIN[k]]."""

    def emit(context, builder, signature, values):
        for array, lane in zip(_elements(builder, values[0]), PLAIN, strict=False):
            place = _pointer(context, builder, signature.args[2], values[2], ir.Constant(values[1].type, lane))
            builder.store(builder.load(place), _pointer(context, builder, signature.args[0].dtype, array, values[1]))
        return context.get_dummy_value()

    return types.void(arrays, types.int64, sums), emit


class _Folding:
    """Sums of vectors by halves: what costs is one shuffle or two and an addition, for two vectors at a time."""

    HALVES = [*range(8), *range(16, 24)], [*range(8, 16), *range(24, 32)]
    QUADS = [k for q in (0, 8, 16, 24) for k in range(q, q + 4)], [k for q in (4, 12, 20, 28) for k in range(q, q + 4)]

    def __init__(self, builder):
        self.builder = builder

    def times(self, x, y):
        return self.builder.fmul(x, y, flags=FLAGS)

    def replaced(self, x, start, y):
        """x with the lanes of y from `start` on; None changes nothing."""
        return x if y is None else _shuffle(self.builder, x, [*range(start), *range(16 + start, 32)], y)

    def rows(self, a, b, c, d):
        """Quads a, b, c, d: the sums of each one's columns. None is nothing; all None give None."""
        return self._pair(self._pair(a, b, *self.HALVES), self._pair(c, d, *self.HALVES), *self.QUADS)

    def columns(self, a, b, c, d):
        """Lane 4 q + 0, 1, 2, 3: the sum of quad q of a, b, c, d."""
        near = [self._near(1), self._near(2)]
        return self._pair(self._pair(a, b, *near[0]), self._pair(c, d, *near[0]), *near[1])

    def _near(self, distance):
        low = [k // (2 * distance) * 2 * distance + k % distance + 16 * (k // distance % 2) for k in range(LANES)]
        return low, [k + distance for k in low]

    def _pair(self, x, y, low, high):
        """Lanes `low` plus lanes `high` of x and y together."""
        if x is None and y is None:
            return None
        x, y = y if x is None else x, x if y is None else y
        shuffled = [_shuffle(self.builder, x, lanes, y) for lanes in (low, high)]
        return self.builder.fadd(*shuffled, flags=FLAGS)
