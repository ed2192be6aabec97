"""The MLP of the SH transfer on some rows, there and back, in one Numba kernel each: its own small matrix products.

The matrices are tall and a few dozen wide. Called one by one from Python, a BLAS computes them as fast as `multiply` does,
but the threads then wait for each other at the interpreter's lock (a third of the time on two), and bias, ReLU and tanh
are passes of their own. Here a strip of rows stays in cache from the first layer to the last.

Weights come turned, (inputs, outputs), and padded with zeros to whole panels; `back_` ones, for the way back, are padded
but not turned. Buffers have padded columns too, which stay zero.
"""

import numpy as np

from core.appearance.encoding import encoded_size
from core.appearance.transfer_arithmetic import bound_softly, encode_places
from core.compiled import kernel, part
from core.simd import LANES, broadcast, broadcast_element, load, maximum, multiply_add, store

STRIP = 128  # rows at a time: what is at work on them fits the second-level cache, at width 32 nearly the first
PANEL = 2 * LANES  # columns of a product are a multiple of this
QUAD = 4  # and its rows of this
ANY, ZERO = np.float32(-np.inf), np.float32(0)  # the least value that a product may have: any, or that of a ReLU


def padded(count, to):
    """`count` rounded up to a multiple."""
    return (count + to - 1) // to * to


_padded, _encoded_size = part(padded), part(encoded_size)


@part
def multiply(left, turned, right, start, into, least):
    """into = max(start + left right, least), or with the transpose of `left` if it is `turned`. What is not a number stays so.

    All (rows, columns) and contiguous; `into` may be `start`. Its rows are whole quads, its columns whole panels, and
    `right` has as many rows as the sums have terms. `start` may be one row for all.

    Four rows by sixteen columns are eight registers that add up at once, which is what hides the latency of a
    multiply-add, with one load for each two of them.
    """
    rows, columns = into.shape
    left_row, left_column = (1, left.shape[1]) if turned else (left.shape[1], 1)
    right_row = right.shape[1]
    start_row = columns if start.shape[0] > 1 else 0
    floor = broadcast(least)
    for column in range(0, columns, PANEL):
        for row in range(0, rows, QUAD):
            at = row * start_row + column
            a0, b0 = load(start, at), load(start, at + LANES)
            a1, b1 = load(start, at + start_row), load(start, at + start_row + LANES)
            a2, b2 = load(start, at + 2 * start_row), load(start, at + 2 * start_row + LANES)
            a3, b3 = load(start, at + 3 * start_row), load(start, at + 3 * start_row + LANES)
            x, y = row * left_row, column
            for _ in range(right.shape[0]):
                a, b = load(right, y), load(right, y + LANES)
                x0, x1 = broadcast_element(left, x), broadcast_element(left, x + left_row)
                x2, x3 = broadcast_element(left, x + 2 * left_row), broadcast_element(left, x + 3 * left_row)
                a0, b0 = multiply_add(x0, a, a0), multiply_add(x0, b, b0)
                a1, b1 = multiply_add(x1, a, a1), multiply_add(x1, b, b1)
                a2, b2 = multiply_add(x2, a, a2), multiply_add(x2, b, b2)
                a3, b3 = multiply_add(x3, a, a3), multiply_add(x3, b, b3)
                x += left_column
                y += right_row
            at = row * columns + column
            store(into, at, maximum(floor, a0))
            store(into, at + LANES, maximum(floor, b0))
            store(into, at + columns, maximum(floor, a1))
            store(into, at + columns + LANES, maximum(floor, b1))
            store(into, at + 2 * columns, maximum(floor, a2))
            store(into, at + 2 * columns + LANES, maximum(floor, b2))
            store(into, at + 3 * columns, maximum(floor, a3))
            store(into, at + 3 * columns + LANES, maximum(floor, b3))


@part
def copy_rows(learned, begin, end, inputs):
    """Rows begin..end of the learned part of the input; zeros beyond."""
    for i in range(end - begin):
        for j in range(learned.shape[1]):
            inputs[i, j] = learned[begin + i, j]
    inputs[end - begin :] = 0


@part
def read_strip(learned, means, octaves, begin, end, inputs, places):
    """Rows begin..end of both parts of the input: `learned` as it is, places encoded and transposed; zeros beyond."""
    copy_rows(learned, begin, end, inputs)
    encode_places(means[begin:end], octaves, places[: _encoded_size(3, octaves)])


@kernel
def evaluate(
    begin, end, learned, means, octaves, bound, base,
    learned_weight, place_weight, first_bias, hidden_weights, hidden_biases, output_weight, skip_weight, output_bias,
    kept, output,
):  # fmt: skip
    """Write rows begin..end of bound * tanh(y / bound), plus those of `base` unless that is empty, to `output` (n, out).

    kept: (layers, whole strips of rows, width) for the hidden layers, or (layers, 0, width) if nobody asks for them.
    """
    inputs = np.zeros((STRIP, _padded(learned.shape[1], QUAD)), np.float32)
    places = np.empty((len(place_weight), STRIP), np.float32)
    y = np.empty((STRIP, len(output_bias)), np.float32)
    keeps = kept.shape[1] > 0
    hidden = kept if keeps else np.empty((kept.shape[0], STRIP, kept.shape[2]), np.float32)
    for first in range(begin, end, STRIP):
        last = min(first + STRIP, end)
        read_strip(learned, means, octaves, first, last, inputs, places)
        at = first if keeps else 0
        here = hidden[0, at : at + STRIP]
        multiply(inputs, False, learned_weight, first_bias.reshape(1, -1), here, ANY)
        multiply(places, True, place_weight, here, here, ZERO)
        for layer in range(len(hidden_weights)):
            before, here = here, hidden[layer + 1, at : at + STRIP]
            multiply(before, False, hidden_weights[layer], hidden_biases[layer : layer + 1], here, ZERO)
        multiply(here, False, output_weight, output_bias.reshape(1, -1), y, ANY)
        multiply(inputs, False, skip_weight, y, y, ANY)
        bound_softly(y.reshape(-1), bound)
        for i in range(last - first):
            for j in range(output.shape[1]):
                output[first + i, j] = y[i, j] + base[first + i, j] if len(base) else y[i, j]


@kernel
def differentiate_output(
    begin, end, learned, bound, output, output_gradient, kept, to_output_weight, to_skip_weight, to_output_bias,
):  # fmt: skip
    """From dL/d(output), rows begin..end, add to dL/d(weights) of the output layer, turned and padded (also to quads).

    output, kept: as `evaluate` left them, without a base. What is wanted may be empty: then nobody asks for it.
    """
    inputs = np.zeros((STRIP, _padded(learned.shape[1], QUAD)), np.float32)
    before_output = np.zeros((STRIP, _padded(output.shape[1], PANEL)), np.float32)
    for first in range(begin, end, STRIP):
        last = min(first + STRIP, end)
        copy_rows(learned, first, last, inputs)
        before_bound(output[first:last], output_gradient[first:last], bound, before_output)
        add_products(inputs, True, before_output, to_skip_weight)
        add_products(kept[kept.shape[0] - 1, first : first + STRIP], True, before_output, to_output_weight)
        add_rows(before_output, to_output_bias)


@kernel
def differentiate_hidden(
    begin, end, learned, means, octaves, bound, output, output_gradient, kept,
    back_learned, back_hidden, back_output, back_skip,
    to_learned, to_learned_weight, to_place_weight, to_first_bias, to_hidden_weights, to_hidden_biases,
):  # fmt: skip
    """As `differentiate_output` for the hidden layers, and write dL/d(learned)."""
    columns, wide, layers = learned.shape[1], kept.shape[2], len(back_hidden)
    inputs = np.zeros((STRIP, _padded(columns, QUAD)), np.float32)
    places = np.zeros((_padded(_encoded_size(3, octaves), QUAD), STRIP), np.float32)
    before_output = np.zeros((STRIP, _padded(output.shape[1], PANEL)), np.float32)
    gradient, before = np.empty((STRIP, wide), np.float32), np.empty((STRIP, wide), np.float32)
    block = np.empty((STRIP, back_learned.shape[1]), np.float32)
    nothing = np.zeros((1, max(wide, block.shape[1])), np.float32)
    for first in range(begin, end, STRIP):
        last = min(first + STRIP, end)
        read_strip(learned, means, octaves, first, last, inputs, places)
        before_bound(output[first:last], output_gradient[first:last], bound, before_output)
        multiply(before_output, False, back_output, nothing, gradient, ANY)
        stop_at_zeros(gradient, kept[layers, first : first + STRIP])
        for layer in range(layers - 1, -1, -1):
            here = kept[layer, first : first + STRIP]
            if to_hidden_weights.size:
                add_products(here, True, gradient, to_hidden_weights[layer])
            if to_hidden_biases.size:
                add_rows(gradient, to_hidden_biases[layer])
            multiply(gradient, False, back_hidden[layer], nothing, before, ANY)
            stop_at_zeros(before, here)
            gradient, before = before, gradient
        add_products(inputs, True, gradient, to_learned_weight)
        add_products(places, False, gradient, to_place_weight)
        add_rows(gradient, to_first_bias)
        if to_learned.size:
            multiply(gradient, False, back_learned, nothing, block, ANY)
            if back_skip.size:
                multiply(before_output, False, back_skip, block, block, ANY)
            for i in range(last - first):
                for j in range(columns):
                    to_learned[first + i, j] = block[i, j]


@part
def before_bound(output, output_gradient, bound, into):
    """dL/dy of y -> bound * tanh(y / bound): the gradient times 1 - (output / bound)^2; zero in the rows beyond."""
    inverse = np.float32(1) / bound
    for i in range(output.shape[0]):
        for j in range(output.shape[1]):
            share = output[i, j] * inverse
            into[i, j] = (np.float32(1) - share * share) * output_gradient[i, j]
    into[output.shape[0] :] = 0


@part
def add_products(inputs, turned, gradient, sums):
    """Add the gradient of a weight, unless nobody asks: inputs' gradient, from inputs that are `turned` on the way or were."""
    if sums.size:
        multiply(inputs, turned, gradient, sums, sums, ANY)


@part
def add_rows(gradient, sums):
    """Add the gradient of a bias, unless nobody asks."""
    if sums.size:
        for i in range(gradient.shape[0]):
            for j in range(gradient.shape[1]):
                sums[j] += gradient[i, j]


@part
def stop_at_zeros(gradient, hidden):
    """No gradient passes where a ReLU gave zero."""
    flat, values = gradient.reshape(-1), hidden.reshape(-1)
    for i in range(len(flat)):
        flat[i] = np.float32(0) if values[i] <= 0 else flat[i]
