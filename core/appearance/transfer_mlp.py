"""The MLP inside the SH transfer: the definition in plain torch, and the same in blocks for the CPU.

h_1 = relu(x W_1' + b_1), h_i = relu(h_(i-1) W_i' + b_i), y = bound * tanh((h_n V' + x_features S' + b) / bound). A
Gaussian's input x has two parts: its features, gamma(sh) and behind it the latents if there are any, which receive a
gradient and may also skip to the output; and its encoded place, which does neither.

Blocks of ROWS rows are what threads share; `transfer_kernels` computes them. A row's result does not depend on what it
is evaluated with, so bakes equal live renders bit for bit. Weight gradients are summed a block at a time and then in
the order of the blocks: the same for any number of threads.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.utils.checkpoint import checkpoint

from core.appearance.matrix_product import PANEL, TILE_ROWS, aligned_empty
from core.appearance.positional_encoding import encoded_positions
from core.appearance.transfer_kernels import STRIP, hidden_backward, mlp_forward, output_backward, rounded_up
from core.system.device import array_of
from core.system.threads import in_parallel

CHUNK_BYTES = 2 << 30  # half a million rows of the paper's width, more than a million of the default
ROWS = 8 * STRIP  # of a block: half a millisecond of work
BLOCKS = 32  # at most, in the forward pass
NOTHING = np.empty((0, 0), np.float32)


class HiddenLayers(NamedTuple):
    """Weights (outputs, inputs) and biases: the first layer's for either part of the input,
    and the further hidden ones'."""

    feature_weight: Float[Tensor, "width features"]
    position_weight: Float[Tensor, "width encoded"]
    first_bias: Float[Tensor, " width"]
    hidden_weights: Float[Tensor, "more width width"]
    hidden_biases: Float[Tensor, "more width"]


class OutputLayer(NamedTuple):
    """`skip_weight` has no columns where nothing skips the hidden layers."""

    output_weight: Float[Tensor, "out width"]
    skip_weight: Float[Tensor, "out skipping"]
    output_bias: Float[Tensor, " out"]


def plain_mlp(
    features: Float[Tensor, "n features"],
    means: Float[Tensor, "n 3"],
    hidden_layers: HiddenLayers,
    output_layer: OutputLayer,
    octaves: int,
    bound: float,
) -> Float[Tensor, "n out"]:
    """The definition: any dtype, any device, differentiable by autograd but for the means.
    Outputs lie in [-bound, bound].

    means: scene frame. octaves: of the encoding of the contracted means, see core.appearance.positional_encoding.
    """
    linear = torch.addmm  # a bias, or what is already there, plus a product: one kernel on a GPU
    hidden = linear(hidden_layers.first_bias, encoded_positions(means, octaves), hidden_layers.position_weight.T)
    hidden = torch.relu(linear(hidden, features, hidden_layers.feature_weight.T))
    for weight, bias in zip(hidden_layers.hidden_weights, hidden_layers.hidden_biases):
        hidden = torch.relu(linear(bias, hidden, weight.T))
    output = linear(output_layer.output_bias, hidden, output_layer.output_weight.T)
    if output_layer.skip_weight.shape[1]:
        output = linear(output, features, output_layer.skip_weight.T)
    return bound * torch.tanh(output / bound)


def chunked_mlp(
    features: Float[Tensor, "n features"],
    means: Float[Tensor, "n 3"],
    hidden_layers: HiddenLayers,
    output_layer: OutputLayer,
    octaves: int,
    bound: float,
) -> Float[Tensor, "n out"]:
    """`plain_mlp` within CHUNK_BYTES: rows that do not fit go in chunks,
    of which the backward pass computes each again."""
    inputs = features.shape[1] + hidden_layers.position_weight.shape[1]
    layers = 1 + len(hidden_layers.hidden_weights)
    # Kept for the backward pass: both inputs, each hidden layer before and after its ReLU, and three steps of the
    # output.
    kept = inputs + 2 * len(hidden_layers.first_bias) * layers + 3 * len(output_layer.output_bias)
    rows = max(1, CHUNK_BYTES // (kept * features.element_size()))
    given = hidden_layers, output_layer, octaves, bound
    if len(features) <= rows:
        return plain_mlp(features, means, *given)
    parts = zip(features.split(rows), means.split(rows))
    return torch.cat(
        [checkpoint(plain_mlp, *part, *given, use_reentrant=False, preserve_rng_state=False) for part in parts]
    )


def blockwise_mlp(
    encoded_sh: Float[Tensor, "n g"],
    latents: Float[Tensor, "n k"] | None,
    means: Float[Tensor, "n 3"],
    hidden_layers: HiddenLayers,
    output_layer: Callable[[], OutputLayer],
    octaves: int,
    bound: float,
) -> Float[Tensor, "n out"]:
    """`plain_mlp` for float32 on the CPU, on core.system.threads.threads() threads.
    The latents are the last columns of the features.

    output_layer: makes the output layer. It is called twice: first for its values alone, and then, once the hidden
    layers are in the graph, to be part of the graph as well. Autograd goes back in the reverse order of creation. So
    what the output layer is made of has its gradient before the backward pass through the hidden layers begins.
    """
    inputs = _inputs_of(encoded_sh, latents, means, octaves, bound)
    keeps = torch.is_grad_enabled()
    with torch.no_grad():
        evaluated = _evaluated(inputs, hidden_layers, output_layer(), NOTHING, keeps)
    output = _ThroughHidden.apply(evaluated, encoded_sh, latents, *hidden_layers)
    return _ThroughOutput.apply(evaluated, output, *output_layer())


@torch.no_grad()
def blockwise_sum(
    base: Float[Tensor, "n out"],
    encoded_sh: Float[Tensor, "n g"],
    latents: Float[Tensor, "n k"] | None,
    means: Float[Tensor, "n 3"],
    hidden_layers: HiddenLayers,
    output_layer: OutputLayer,
    octaves: int,
    bound: float,
) -> Float[Tensor, "n out"]:
    """base + blockwise_mlp(...), the same bits: without a gradient, in one pass."""
    inputs = _inputs_of(encoded_sh, latents, means, octaves, bound)
    return torch.from_numpy(_evaluated(inputs, hidden_layers, output_layer, array_of(base), keeps=False).output)


class _Inputs(NamedTuple):
    """What the layers are evaluated on, as the kernels take it."""

    encoded_sh: np.ndarray
    latents: np.ndarray
    means: np.ndarray
    octaves: int
    bound: np.float32


class _Evaluated(NamedTuple):
    """What the forward pass leaves to the backward pass.

    output_layer: its values. kept: the hidden layers (layers, padded rows, padded width), without rows if no backward
    pass comes. output: (n, out).
    """

    inputs: _Inputs
    output_layer: OutputLayer
    kept: np.ndarray
    output: np.ndarray


def _inputs_of(encoded_sh: Tensor, latents: Tensor | None, means: Tensor, octaves: int, bound: float) -> _Inputs:
    latent_array = NOTHING if latents is None else array_of(latents)
    return _Inputs(array_of(encoded_sh), latent_array, array_of(means), octaves, np.float32(bound))


def _evaluated(
    inputs: _Inputs, hidden_layers: HiddenLayers, output_layer: OutputLayer, base: np.ndarray, keeps: bool
) -> _Evaluated:
    """All layers; onto `base` unless that is empty."""
    weights = [_with_padding(weight) for weight in (*_transposed(hidden_layers), *_transposed(output_layer))]
    rows = len(inputs.encoded_sh)
    # Kept for the backward pass: 4 * layers * width bytes per Gaussian. Computing it again instead took 15 % more of a
    # step.
    shape = 1 + len(hidden_layers.hidden_weights), rounded_up(rows, STRIP) if keeps else 0, weights[0].shape[1]
    # NumPy asks the system for huge pages and torch does not: a tenth of the time of a bake. Large blocks, so that two
    # threads seldom meet in a page that is not there yet: both would fill it.
    kept, output = _aligned_empty(shape), _aligned_empty((rows, len(output_layer.output_bias)))
    in_parallel(
        lambda begin, end: mlp_forward(begin, end, *inputs, base, *weights, kept, output),
        rows,
        ROWS * (1 + rows // (BLOCKS * ROWS)),
    )
    return _Evaluated(inputs, output_layer, kept, output)


# The output is a function of the hidden layers and of the output layer. In the graph it takes two steps, both with the
# value that is evaluated already: each has the gradients of its own layers, and the second passes the output's on to
# the first as it came.


class _ThroughHidden(torch.autograd.Function):
    """The output, as a function of the features and of the hidden layers."""

    @staticmethod
    def forward(ctx, evaluated: _Evaluated, encoded_sh: Tensor, latents: Tensor | None, *weights: Tensor) -> Tensor:
        ctx.save_for_backward(*weights)
        ctx.evaluated = evaluated
        return torch.from_numpy(evaluated.output)

    @staticmethod
    @once_differentiable
    def backward(ctx, output_gradient: Tensor):
        (inputs, output_layer, kept, output), hidden_layers = ctx.evaluated, HiddenLayers(*ctx.saved_tensors)
        feature_parts, wants = (inputs.encoded_sh, inputs.latents), ctx.needs_input_grad[1:3]
        to_inputs = [
            np.empty(part.shape if wanted else (0, 0), np.float32) for part, wanted in zip(feature_parts, wants)
        ]
        back = (
            hidden_layers.feature_weight,
            hidden_layers.hidden_weights,
            output_layer.output_weight,
            output_layer.skip_weight,
        )
        given = *inputs, output, array_of(output_gradient), kept, *map(_with_padding, back), *to_inputs
        gradients = _summed(hidden_backward, given, len(output), hidden_layers, ctx.needs_input_grad[3:])
        return None, *(torch.from_numpy(part) if wanted else None for part, wanted in zip(to_inputs, wants)), *gradients


class _ThroughOutput(torch.autograd.Function):
    """The same output, as a function of the output layer too."""

    @staticmethod
    def forward(ctx, evaluated: _Evaluated, output: Tensor, *weights: Tensor) -> Tensor:
        ctx.save_for_backward(*weights)
        ctx.evaluated = evaluated
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx, output_gradient: Tensor):
        (inputs, _, kept, output), output_layer = ctx.evaluated, OutputLayer(*ctx.saved_tensors)
        given = inputs.encoded_sh, inputs.latents, inputs.bound, output, array_of(output_gradient), kept
        gradients = _summed(output_backward, given, len(output), output_layer, ctx.needs_input_grad[2:])
        return None, output_gradient, *gradients


def _summed(
    differentiate: Callable[..., None],
    given: tuple,
    rows: int,
    layers: HiddenLayers | OutputLayer,
    wants: tuple[bool, ...],
) -> list[Tensor | None]:
    """The gradients of the weights, None for those not wanted.

    differentiate: a kernel; called as (begin, end, *given, *parts), it writes into `parts` what the rows begin..end add
    to each gradient.
    """
    transposed = _transposed(layers)
    shapes = [_padded_shape(weight) if wanted else (0,) * weight.dim() for weight, wanted in zip(transposed, wants)]
    # Each block has sums of its own, which are then added in the order of the blocks.
    sums = [_aligned_empty((-(-rows // ROWS), *shape)) for shape in shapes]
    in_parallel(
        lambda begin, end: differentiate(begin, end, *given, *(part[begin // ROWS] for part in sums)), rows, ROWS
    )
    totals = [torch.from_numpy(part.sum(axis=0)) for part in sums]
    cut = type(layers)(*(total[tuple(map(slice, weight.shape))] for total, weight in zip(totals, transposed)))
    return [gradient if wanted else None for gradient, wanted in zip(_transposed(cut), wants)]


def _transposed(layers: HiddenLayers | OutputLayer) -> HiddenLayers | OutputLayer:
    """Weights as (inputs, outputs), or back again; biases as they are."""
    return type(layers)(
        *(part if name.endswith(("bias", "biases")) else part.mT for name, part in layers._asdict().items())
    )


def _padded_shape(weight: Tensor) -> tuple[int, ...]:
    """The shape in which the kernels sum a transposed weight's gradient: whole panels, and tiles' whole rows."""
    multiples = (1, TILE_ROWS, PANEL)[-weight.dim() :]
    return tuple(rounded_up(size, to) for size, to in zip(weight.shape, multiples, strict=True))


def _with_padding(weight: Tensor) -> np.ndarray:
    """The weight with zeros behind its columns, to whole panels."""
    array = weight.detach().numpy()
    result = _aligned_empty((*array.shape[:-1], rounded_up(array.shape[-1], PANEL)))
    result[..., array.shape[-1] :] = 0
    result[..., : array.shape[-1]] = array
    return result


def _aligned_empty(shape: tuple[int, ...]) -> np.ndarray:
    return aligned_empty(math.prod(shape)).reshape(shape)
