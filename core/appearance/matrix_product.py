"""A matrix product for Numba kernels, whose matrices are tall and a few dozen wide: a tile of sums stays in registers.

LLVM's vectors of a whole panel become one register where the processor has AVX-512, or as many narrower ones as it
takes. A sum adds its terms up in their order, whatever the tile: the tile is a matter of speed, not of bits.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, codegen, config
from numba.extending import intrinsic

from core.kernels.compiled import part
from core.kernels.simd import element_pointer, fused_multiply_add, in_all_lanes, larger

CACHE_LINE = 16  # floats
PANEL = 16  # columns of a product are a multiple of this
ANY, ZERO = np.float32(-np.inf), np.float32(0)  # the least value that a product may have: any, or that of a ReLU
VECTOR = ir.VectorType(ir.FloatType(), PANEL)


def has_avx512() -> bool:
    """Whether Numba compiles for 32 registers of 512 bits, in place of 16 of 256 or fewer."""
    features = codegen.get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES
    return "+avx512f" in features.split(",")


# Of a tile; the rows of a product are a multiple of its rows. So many sums hide the latency of a multiply-add and leave
# registers for its factors. A product of 64 x 64, GFLOP/s on one core: 8 x 2 129, 4 x 2 119, 8 x 1 100, 4 x 1 90 (MKL:
# 155); without AVX-512 82 by 4 x 1, 68 by any other (100). Of 64 x 48, the harmonics of degree 3, 8 x 3 takes 15 % less
# time than 8 x 2 and 8 x 1 beside it.
TILE_ROWS, TILE_PANELS, WIDE_PANELS = (8, 2, 3) if has_avx512() else (4, 1, 1)


def tile_of(panels: int):
    """The intrinsic that computes a tile, TILE_ROWS by `panels`, of what `multiply` does:
    from `row` and `column` on."""

    @intrinsic
    def tile(typing_context, left, left_row, left_column, right, start, start_row, into, row, column, least):
        def generate(context, builder, sig, args):
            left, left_row, left_column, right, start, start_row, into, row, column, least = args
            left_type, right_type, start_type, into_type = sig.args[0], sig.args[3], sig.args[4], sig.args[6]
            terms, columns = cgutils.unpack_tuple(
                builder, context.make_array(right_type)(context, builder, right).shape
            )

            def plus(number, constant):
                return builder.add(number, ir.Constant(number.type, constant))

            def panel(array_type, array, index):
                return builder.bitcast(element_pointer(context, builder, array_type, array, index), VECTOR.as_pointer())

            sums = [[cgutils.alloca_once(builder, VECTOR) for _ in range(panels)] for _ in range(TILE_ROWS)]
            for i, row_sums in enumerate(sums):
                at = builder.add(builder.mul(plus(row, i), start_row), column)
                for j, total in enumerate(row_sums):
                    begun = builder.load(panel(start_type, start, plus(at, j * PANEL)), align=4)
                    builder.store(begun, total)
            with cgutils.for_range(builder, terms) as term:
                at = builder.add(builder.mul(term.index, columns), column)
                weights = [builder.load(panel(right_type, right, plus(at, j * PANEL)), align=4) for j in range(panels)]
                for i, row_sums in enumerate(sums):
                    at = builder.add(builder.mul(plus(row, i), left_row), builder.mul(term.index, left_column))
                    factor = in_all_lanes(
                        builder, builder.load(element_pointer(context, builder, left_type, left, at)), PANEL
                    )
                    for weight, total in zip(weights, row_sums):
                        builder.store(fused_multiply_add(builder, factor, weight, builder.load(total)), total)
            floor = in_all_lanes(builder, least, PANEL)
            for i, row_sums in enumerate(sums):
                at = builder.add(builder.mul(plus(row, i), columns), column)
                for j, total in enumerate(row_sums):
                    value = larger(builder, floor, builder.load(total))
                    builder.store(value, panel(into_type, into, plus(at, j * PANEL)), align=4)
            return context.get_dummy_value()

        index = types.intp
        return types.void(left, index, index, right, start, index, into, index, index, types.float32), generate

    return tile


def aligned_empty(count: int):
    """(count,) float32, uninitialised, from the beginning of a cache line on:
    vectors that lie across two take two loads, 10 % of a product."""
    room = np.empty(count + CACHE_LINE, np.float32)
    begun = room.ctypes.data // room.itemsize % CACHE_LINE
    return room[CACHE_LINE - begun :][:count]


_wide_tile, _tile, _narrow_tile = tile_of(WIDE_PANELS), tile_of(TILE_PANELS), tile_of(1)


@part
def multiply(left, transpose, right, start, into, least):
    """into = max(start + left right, least), with the transpose of `left` if `transpose`. NaN stays NaN.

    All (rows, columns), float32 and contiguous; `into` may be `start`. Its rows are a multiple of TILE_ROWS, its
    columns whole panels, and `right` has as many rows as the sums have terms. `start` may be one row for all.
    """
    rows, columns = into.shape
    left_row, left_column = (1, left.shape[1]) if transpose else (left.shape[1], 1)
    start_row = columns if start.shape[0] > 1 else 0
    wide = columns if columns % (WIDE_PANELS * PANEL) == 0 else 0
    tiled = max(wide, columns - columns % (TILE_PANELS * PANEL))
    for column in range(0, wide, WIDE_PANELS * PANEL):
        for row in range(0, rows, TILE_ROWS):
            _wide_tile(left, left_row, left_column, right, start, start_row, into, row, column, least)
    for column in range(wide, tiled, TILE_PANELS * PANEL):
        for row in range(0, rows, TILE_ROWS):
            _tile(left, left_row, left_column, right, start, start_row, into, row, column, least)
    for column in range(tiled, columns, PANEL):
        for row in range(0, rows, TILE_ROWS):
            _narrow_tile(left, left_row, left_column, right, start, start_row, into, row, column, least)
