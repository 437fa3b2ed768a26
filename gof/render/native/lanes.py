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


def use_wide_registers(builder) -> None:
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
    use_wide_registers(builder)
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
    return vector(x, distance), lambda context, builder, signature, values: shuffle(builder, values[0], lanes)


def shuffle(builder, x, lanes, y=None):
    """Lanes of x, and of y from 16 on."""
    lanes = ir.Constant(ir.VectorType(I32, len(lanes)), list(lanes))
    return builder.shuffle_vector(x, ir.Constant(x.type, ir.Undefined) if y is None else y, lanes)


# ---------------------------------------------------------------- memory


def pointer_to(context, builder, kind, array, index):
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
        return _constant_load(builder, pointer_to(context, builder, signature.args[0], *values))

    return array.dtype(array, types.int64), emit


@intrinsic
def load(typing, array, index):
    """array[index : index + 16]."""

    def emit(context, builder, signature, values):
        use_wide_registers(builder)
        return _load(builder, pointer_to(context, builder, signature.args[0], *values), VECTOR)

    return vector(array, types.int64), emit


@intrinsic
def store(typing, array, index, x):
    """array[index : index + 16] = x."""

    def emit(context, builder, signature, values):
        _store(builder, pointer_to(context, builder, signature.args[0], *values[:2]), values[2])
        return context.get_dummy_value()

    return types.void(array, types.int64, x), emit


@intrinsic
def store_words(typing, array, index, low, high):
    """array[index : index + 16] = low | high << 16, of whole numbers from 0 to 65535; an array of uint32."""

    def emit(context, builder, signature, values):
        low, high = (builder.fptosi(x, INTEGERS) for x in values[2:])
        words = builder.or_(low, builder.shl(high, ir.Constant(INTEGERS, [16] * LANES)))
        _store(builder, pointer_to(context, builder, signature.args[0], *values[:2]), words)
        return context.get_dummy_value()

    return types.void(array, types.int64, low, high), emit


@intrinsic
def prefetch(typing, array, index):
    """Ask for array[index], which will be wanted soon."""

    def emit(context, builder, signature, values):
        pointer = pointer_to(context, builder, signature.args[0], *values)
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
        pointer = pointer_to(context, builder, signature.args[0], values[0], ir.Constant(ir.IntType(64), 0))
        return builder.atomic_rmw("add", pointer, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), emit


def _block_rows(context, builder, kind, plane, index, stride):
    """Addresses of a block's four rows."""
    for _ in range(4):
        yield pointer_to(context, builder, kind, plane, index)
        index = builder.add(index, stride)


# ---------------------------------------------------------------- one value per plane or channel


def elements(builder, tuple_):
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
        use_wide_registers(builder)
        out = []
        for plane in elements(builder, values[0]):
            pointers = _block_rows(context, builder, signature.args[0].dtype, plane, *values[1:])
            a, b, c, d = (_load(builder, pointer, QUAD) for pointer in pointers)
            top, bottom = shuffle(builder, a, range(8), b), shuffle(builder, c, range(8), d)
            out.append(shuffle(builder, top, range(LANES), bottom))
        return _tuple_of(context, builder, kind, out)

    return kind(planes, types.int64, types.int64), emit


@intrinsic
def store_blocks(typing, planes, index, stride, blocks):
    """Do the reverse of `load_blocks`."""

    def emit(context, builder, signature, values):
        for plane, block in zip(elements(builder, values[0]), elements(builder, values[3]), strict=True):
            pointers = _block_rows(context, builder, signature.args[0].dtype, plane, *values[1:3])
            for row, pointer in enumerate(pointers):
                _store(builder, pointer, shuffle(builder, block, range(4 * row, 4 * row + 4)))
        return context.get_dummy_value()

    return types.void(planes, types.int64, types.int64, blocks), emit


@intrinsic
def scaled(typing, blocks, factor):
    """Each times the factor."""

    def emit(context, builder, signature, values):
        products = [builder.fmul(block, values[1], flags=FLAGS) for block in elements(builder, values[0])]
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
    blocks = elements(builder, blocks)
    pointers = (
        pointer_to(context, builder, kind, array, builder.add(index, ir.Constant(index.type, k)))
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
        for x, y in zip(*(elements(builder, value) for value in values), strict=True):
            total = builder.fadd(builder.fmul(x, y, flags=FLAGS), total, flags=FLAGS)
        return total

    return vector(blocks, others), emit


# ---------------------------------------------------------------- sums over a block
