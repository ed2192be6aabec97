"""The MLP of the SH transfer on some rows, its forward and its backward pass, as Numba kernels.

Called one by one from Python, a BLAS computes the matrix products as fast as `multiply` does, but the threads then wait
for each other at the interpreter's lock (a third of the time on two), and bias, ReLU and tanh are passes of their own.
Here a strip of rows stays in cache from the first layer to the last.

Weights come transposed, (inputs, outputs), and padded with zeros to whole panels; `back_` ones, for the backward pass,
are padded but not transposed. Buffers have padded columns too, which stay zero.
"""

import numpy as np

from core.appearance.matrix_product import ANY, PANEL, TILE_ROWS, ZERO, aligned_empty, multiply
from core.appearance.positional_encoding import encoded_size
from core.appearance.transfer_arithmetic import bound_softly, encode_positions
from core.kernels.compiled import kernel, part

STRIP = 128  # rows at a time: what is at work on them fits the second-level cache, at width 32 nearly the first


def rounded_up(count, to):
    """`count` rounded up to a multiple."""
    return (count + to - 1) // to * to


# As kernels call them.
_rounded_up, _encoded_size, _aligned_empty = part(rounded_up), part(encoded_size), part(aligned_empty)


@part
def aligned_matrix(rows, columns):
    """An uninitialised (rows, columns) float32 matrix, aligned to a cache line."""
    return _aligned_empty(rows * columns).reshape(rows, columns)


@part
def zeros(rows, columns):
    """An `aligned_matrix` of zeros."""
    result = aligned_matrix(rows, columns)
    result[:] = 0
    return result


@part
def buffer_of(encoded_sh, latents):
    """Room for a strip of the features, both parts side by side."""
    return zeros(STRIP, _rounded_up(encoded_sh.shape[1] + latents.shape[1], TILE_ROWS))


@part
def copy_rows(encoded_sh, latents, begin, end, features):
    """Rows begin..end of the features; zeros beyond."""
    columns = encoded_sh.shape[1]
    for i in range(end - begin):
        for j in range(columns):
            features[i, j] = encoded_sh[begin + i, j]
        for j in range(latents.shape[1]):
            features[i, columns + j] = latents[begin + i, j]
    features[end - begin :] = 0


@part
def read_strip(encoded_sh, latents, means, octaves, begin, end, features, positions):
    """Rows begin..end of the whole input: features as they are, positions encoded and transposed; zeros beyond."""
    copy_rows(encoded_sh, latents, begin, end, features)
    encode_positions(means[begin:end], octaves, positions[: _encoded_size(3, octaves)])


@kernel
def mlp_forward(
    begin, end, encoded_sh, latents, means, octaves, bound, base,
    feature_weight, position_weight, first_bias, hidden_weights, hidden_biases, output_weight, skip_weight, output_bias,
    kept, output,
):  # fmt: skip
    """Write rows begin..end of bound * tanh(y / bound),
    plus those of `base` unless that is empty, to `output` (n, out).

    kept: (layers, whole strips of rows, width) for the hidden layers, or (layers, 0, width) if no backward pass will
    ask for them.
    """
    features = buffer_of(encoded_sh, latents)
    positions = aligned_matrix(len(position_weight), STRIP)
    y, narrow = aligned_matrix(STRIP, len(output_bias)), _aligned_empty(STRIP * output.shape[1])
    keeps = kept.shape[1] > 0
    layers, _, width = kept.shape
    hidden = kept if keeps else aligned_matrix(layers * STRIP, width).reshape(layers, STRIP, width)
    for first in range(begin, end, STRIP):
        last = min(first + STRIP, end)
        read_strip(encoded_sh, latents, means, octaves, first, last, features, positions)
        at = first if keeps else 0
        here = hidden[0, at : at + STRIP]
        multiply(features, False, feature_weight, first_bias.reshape(1, -1), here, ANY)
        multiply(positions, True, position_weight, here, here, ZERO)
        for layer in range(len(hidden_weights)):
            before, here = here, hidden[layer + 1, at : at + STRIP]
            multiply(before, False, hidden_weights[layer], hidden_biases[layer : layer + 1], here, ZERO)
        multiply(here, False, output_weight, output_bias.reshape(1, -1), y, ANY)
        multiply(features, False, skip_weight, y, y, ANY)
        bound_softly(
            without_padding(y, output.shape[1], narrow),
            bound,
            base[first:last].reshape(-1),
            output[first:last].reshape(-1),
        )


@kernel
def output_backward(
    begin, end, encoded_sh, latents, bound, output, output_gradient, kept,
    to_output_weight, to_skip_weight, to_output_bias,
):  # fmt: skip
    """Write the part of dL/d(weights) of the output layer that rows begin..end of dL/d(output) make,
    transposed and padded (also to whole tiles).

    output, kept: as `mlp_forward` left them, without a base. A gradient that is not wanted is empty.
    """
    to_output_weight[:], to_skip_weight[:], to_output_bias[:] = 0, 0, 0
    features = buffer_of(encoded_sh, latents)
    before_output = zeros(STRIP, _rounded_up(output.shape[1], PANEL))
    for first in range(begin, end, STRIP):
        last = min(first + STRIP, end)
        copy_rows(encoded_sh, latents, first, last, features)
        bound_backward(output[first:last], output_gradient[first:last], bound, before_output)
        add_weight_gradient(features, True, before_output, to_skip_weight)
        add_weight_gradient(kept[kept.shape[0] - 1, first : first + STRIP], True, before_output, to_output_weight)
        add_bias_gradient(before_output, to_output_bias)


@kernel
def hidden_backward(
    begin, end, encoded_sh, latents, means, octaves, bound, output, output_gradient, kept,
    back_feature, back_hidden, back_output, back_skip,
    to_encoded_sh, to_latents,
    to_feature_weight, to_position_weight, to_first_bias, to_hidden_weights, to_hidden_biases,
):  # fmt: skip
    """As `output_backward` for the hidden layers, and write dL/d(encoded_sh) and dL/d(latents)."""
    to_feature_weight[:], to_position_weight[:], to_first_bias[:] = 0, 0, 0
    to_hidden_weights[:], to_hidden_biases[:] = 0, 0
    columns, wide, layers = encoded_sh.shape[1], kept.shape[2], len(back_hidden)
    features = buffer_of(encoded_sh, latents)
    positions = zeros(_rounded_up(_encoded_size(3, octaves), TILE_ROWS), STRIP)
    before_output = zeros(STRIP, _rounded_up(output.shape[1], PANEL))
    gradient, before = aligned_matrix(STRIP, wide), aligned_matrix(STRIP, wide)
    block = aligned_matrix(STRIP, back_feature.shape[1])
    nothing = zeros(1, max(wide, block.shape[1]))
    for first in range(begin, end, STRIP):
        last = min(first + STRIP, end)
        read_strip(encoded_sh, latents, means, octaves, first, last, features, positions)
        bound_backward(output[first:last], output_gradient[first:last], bound, before_output)
        multiply(before_output, False, back_output, nothing, gradient, ANY)
        relu_backward(gradient, kept[layers, first : first + STRIP])
        for layer in range(layers - 1, -1, -1):
            here = kept[layer, first : first + STRIP]
            if to_hidden_weights.size:
                add_weight_gradient(here, True, gradient, to_hidden_weights[layer])
            if to_hidden_biases.size:
                add_bias_gradient(gradient, to_hidden_biases[layer])
            multiply(gradient, False, back_hidden[layer], nothing, before, ANY)
            relu_backward(before, here)
            gradient, before = before, gradient
        add_weight_gradient(features, True, gradient, to_feature_weight)
        add_weight_gradient(positions, False, gradient, to_position_weight)
        add_bias_gradient(gradient, to_first_bias)
        if to_encoded_sh.size or to_latents.size:
            multiply(gradient, False, back_feature, nothing, block, ANY)
            if back_skip.size:
                multiply(before_output, False, back_skip, block, block, ANY)
            for i in range(last - first):
                for j in range(to_encoded_sh.shape[1]):
                    to_encoded_sh[first + i, j] = block[i, j]
                for j in range(to_latents.shape[1]):
                    to_latents[first + i, j] = block[i, columns + j]


@part
def without_padding(rows, columns, room):
    """The first columns of the rows, one row behind the other, (n,):
    a loop over all of them is a third faster than one in each row.

    In `room`, unless they lie so already.
    """
    if rows.shape[1] == columns:
        return rows.reshape(-1)
    for i in range(len(rows)):
        for j in range(columns):
            room[i * columns + j] = rows[i, j]
    return room


@part
def bound_backward(output, output_gradient, bound, into):
    """dL/dy of y -> bound * tanh(y / bound): the gradient times 1 - (output / bound)^2; zero in the rows beyond."""
    inverse = np.float32(1) / bound
    for i in range(output.shape[0]):
        for j in range(output.shape[1]):
            share = output[i, j] * inverse
            into[i, j] = (np.float32(1) - share * share) * output_gradient[i, j]
    into[output.shape[0] :] = 0


@part
def add_weight_gradient(inputs, transpose, gradient, sums):
    """Add the gradient of a weight, the transposed inputs times `gradient`, unless `sums` is empty.
    transpose: whether the inputs are still to be transposed."""
    if sums.size:
        multiply(inputs, transpose, gradient, sums, sums, ANY)


@part
def add_bias_gradient(gradient, sums):
    """Add the gradient of a bias, unless `sums` is empty."""
    if sums.size:
        for i in range(gradient.shape[0]):
            for j in range(gradient.shape[1]):
                sums[j] += gradient[i, j]


@part
def relu_backward(gradient, hidden):
    """No gradient passes where a ReLU gave zero."""
    flat, values = gradient.reshape(-1), hidden.reshape(-1)
    for i in range(len(flat)):
        flat[i] = np.float32(0) if values[i] <= 0 else flat[i]
