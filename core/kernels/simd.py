"""Eight float32 lanes as a Numba type, and the few primitives that Numba lacks.

LLVM does not vectorise the blending loops by itself (plain ones are eight times slower): the vectors are spelled out.
They are LLVM's own vector type and generic instructions only, nothing of one processor: the compiler maps them to one
256-bit register where there are such, to two of 128 bits on SSE or NEON.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from core.kernels.compiled import exact_part

LANES = 8

FLOATS = ir.VectorType(ir.FloatType(), LANES)
INTEGERS = ir.VectorType(ir.IntType(32), LANES)
BITS = ir.VectorType(ir.IntType(1), LANES)


class Float8Type(types.Type):
    """Eight float32 numbers in one register."""


class Mask8Type(types.Type):
    """Eight truth values, as comparisons make them."""


float8, mask8 = Float8Type("Float8"), Mask8Type("Mask8")
register_model(Float8Type)(lambda manager, numba_type: models.PrimitiveModel(manager, numba_type, FLOATS))
register_model(Mask8Type)(lambda manager, numba_type: models.PrimitiveModel(manager, numba_type, BITS))


# ----------------------------------------------------------------------------------------------------------- operators


def define_operator(function, result, emit) -> None:
    """Let `function(Float8, Float8)`, an operator, stand for the instruction that `emit(builder, a, b)` appends."""

    class Template(ConcreteTemplate):
        cases = (signature(result, float8, float8),)

    infer_global(function)(Template)
    lower_builtin(function, float8, float8)(lambda context, builder, sig, args: emit(builder, *args))


# No fast-math flag on any of them: `exp2` counts on its roundings, and the backward pass on repeating the forward's.
define_operator(operator.add, float8, ir.IRBuilder.fadd)
define_operator(operator.sub, float8, ir.IRBuilder.fsub)
define_operator(operator.mul, float8, ir.IRBuilder.fmul)
define_operator(operator.truediv, float8, ir.IRBuilder.fdiv)
define_operator(operator.ge, mask8, lambda builder, a, b: builder.fcmp_ordered(">=", a, b))


# -------------------------------------------------------------------------------------------------------------- memory


def element_pointer(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


@intrinsic
def load(typing_context, array, index):
    """The eight float32 numbers of a contiguous array from element `index` on; no alignment is asked for."""

    def generate(context, builder, sig, args):
        pointer = element_pointer(context, builder, sig.args[0], *args)
        return builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4)

    return float8(array, types.intp), generate


@intrinsic
def store(typing_context, array, index, value):
    """Write eight numbers to a contiguous float32 array from element `index` on."""

    def generate(context, builder, sig, args):
        pointer = element_pointer(context, builder, sig.args[0], *args[:2])
        builder.store(args[2], builder.bitcast(pointer, FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, float8), generate


@intrinsic
def prefetch(typing_context, array, index):
    """Ask for the memory of element `index`, counted over the whole contiguous array, to be in cache soon."""

    def generate(context, builder, sig, args):
        pointer = element_pointer(context, builder, sig.args[0], *args)
        byte, integer = ir.IntType(8).as_pointer(), ir.IntType(32)
        function_type = ir.FunctionType(ir.VoidType(), [byte, integer, integer, integer])
        function = cgutils.get_or_insert_function(builder.module, function_type, "llvm.prefetch.p0")
        for_reading, keep, data = 0, 3, 1
        hints = [ir.Constant(integer, hint) for hint in (for_reading, keep, data)]
        builder.call(function, [builder.bitcast(pointer, byte), *hints])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


@intrinsic
def fetch_add(typing_context, counters, index, amount):
    """Add `amount` to counters[index] (int64) as one indivisible step and return what was there before."""

    def generate(context, builder, sig, args):
        pointer = element_pointer(context, builder, sig.args[0], *args[:2])
        return builder.atomic_rmw("add", pointer, args[2], "monotonic")

    return types.int64(counters, types.intp, types.int64), generate


# ---------------------------------------------------------------------------------------------------------- arithmetic


def in_all_lanes(builder, number, lanes=LANES):
    nothing = ir.Constant(ir.VectorType(ir.FloatType(), lanes), ir.Undefined)
    vector = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(vector, nothing, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))


def larger(builder, a, b):
    """The larger of vectors of any width, lane by lane; `b` where either is NaN."""
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def fused_multiply_add(builder, a, b, c):
    """a * b + c of vectors of any width."""
    function_type = ir.FunctionType(a.type, [a.type] * 3)
    function = cgutils.get_or_insert_function(builder.module, function_type, f"llvm.fmuladd.v{a.type.count}f32")
    return builder.call(function, [a, b, c])


@intrinsic
def broadcast(typing_context, number):
    """A number, rounded to float32, in all eight lanes."""

    def generate(context, builder, sig, args):
        return in_all_lanes(builder, args[0])

    return float8(types.float32), generate


@intrinsic
def multiply_add(typing_context, a, b, c):
    """a * b + c, rounded once where the processor has the instruction, twice where it has not."""

    def generate(context, builder, sig, args):
        return fused_multiply_add(builder, *args)

    return float8(float8, float8, float8), generate


@intrinsic
def minimum(typing_context, a, b):
    """The smaller, lane by lane; `b` where either is NaN."""

    def generate(context, builder, sig, args):
        return builder.select(builder.fcmp_ordered("<", *args), *args)

    return float8(float8, float8), generate


@intrinsic
def maximum(typing_context, a, b):
    """The larger, lane by lane; `b` where either is NaN."""

    def generate(context, builder, sig, args):
        return larger(builder, *args)

    return float8(float8, float8), generate


@intrinsic
def select(typing_context, mask, a, b):
    """`a` where the mask is set, else `b`; what the other holds, NaN included, does not matter."""

    def generate(context, builder, sig, args):
        return builder.select(*args)

    return float8(mask8, float8, float8), generate


@intrinsic
def bits(typing_context, mask):
    """The mask as an integer, lane 0 in the lowest bit."""

    def generate(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(32))

    return types.uint32(mask8), generate


@intrinsic
def lowest_set_bit(typing_context, number):
    """The position of the lowest set bit of a uint32 that is not zero."""

    def generate(context, builder, sig, args):
        position = builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))
        return builder.zext(position, ir.IntType(64))

    return types.intp(types.uint32), generate


@intrinsic
def times_power_of_two(typing_context, numbers, shifted):
    """numbers * 2^n for integers n that were made by adding ROUNDING: they are then the lowest bits of `shifted`."""

    def generate(context, builder, sig, args):
        exponents = builder.shl(builder.bitcast(args[1], INTEGERS), ir.Constant(INTEGERS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(args[0], INTEGERS), exponents), FLOATS)

    return float8(float8, float8), generate


# Added to a float32 number below 2^22 in size it pushes the fraction out of the mantissa: that rounds to the nearest
# integer.
ROUNDING = np.float32(1.5 * 2**23)
# 2^f on [-1/2, 1/2] with the least relative error (9e-8) of all quintics that are exact at 0; 1.1e-7 with coefficients
# in float32.
EXP2 = tuple(np.float32(c) for c in (1.0, 0.693147, 0.24022242, 0.055507336, 0.009671513, 0.0013264728))


@exact_part
def exp2(exponents):
    """2^exponents, lane by lane, to 2e-7 relative, for exponents in [-126, 127]; anything at all outside."""
    shifted = exponents + broadcast(ROUNDING)
    fraction = exponents - (shifted - broadcast(ROUNDING))
    square = fraction * fraction
    # Estrin's form: three short chains instead of one long one.
    low = multiply_add(fraction, broadcast(EXP2[1]), broadcast(EXP2[0]))
    middle = multiply_add(fraction, broadcast(EXP2[3]), broadcast(EXP2[2]))
    high = multiply_add(fraction, broadcast(EXP2[5]), broadcast(EXP2[4]))
    power = multiply_add(square, multiply_add(square, high, middle), low)
    return times_power_of_two(power, shifted)


# ---------------------------------------------------------------------------------------------------- across the lanes


def shuffled(builder, a, b, lanes):
    """Eight of the sixteen numbers of `a` (0..7) and `b` (8..15)."""
    return builder.shuffle_vector(a, b, ir.Constant(INTEGERS, lanes))


@intrinsic
def lane_sums(typing_context, a, b, c, d, e, f, g, h):
    """The sums over the lanes of eight vectors, as the eight lanes of one."""
    # A transposition that adds on its way: 21 instructions where eight separate sums take 48. The first two rounds stay
    # within 128-bit halves, which is what processors shuffle fast.
    even, odd = [0, 2, 8, 10, 4, 6, 12, 14], [1, 3, 9, 11, 5, 7, 13, 15]
    lower, upper = [0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]

    def generate(context, builder, sig, args):
        vectors = list(args)
        for first, second in ((even, odd), (even, odd), (lower, upper)):
            pairs = zip(vectors[::2], vectors[1::2])
            vectors = [
                builder.fadd(shuffled(builder, *pair, first), shuffled(builder, *pair, second)) for pair in pairs
            ]
        return vectors[0]

    return float8(*[float8] * 8), generate


def define_reduction(emit):
    """An intrinsic that folds the lanes of a vector in halves with `emit(builder, a, b)`."""

    @intrinsic
    def reduction(typing_context, vector):
        def generate(context, builder, sig, args):
            folded = args[0]
            for lanes in ([4, 5, 6, 7] * 2, [2, 3] * 4, [1] * 8):
                folded = emit(builder, folded, shuffled(builder, folded, folded, lanes))
            return builder.extract_element(folded, ir.Constant(ir.IntType(32), 0))

        return types.float32(float8), generate

    return reduction


lane_sum = define_reduction(ir.IRBuilder.fadd)
lane_maximum = define_reduction(larger)
