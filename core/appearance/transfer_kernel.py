"""The MLP inside the SH transfer: the definition in plain torch, and the same in blocks for the CPU.

h_1 = relu(x W_1' + b_1), h_i = relu(h_(i-1) W_i' + b_i), y = bound * tanh((h_n V' + x_learned S' + b) / bound). The input x comes
in two parts: `learned` columns, which receive a gradient and may also skip to the output, and the encoded places of the Gaussians,
which do neither.

Blocks of ROWS rows are what threads share; `transfer_blocks` computes them. A row's result does not depend on what it is evaluated
with, so bakes equal live renders bit for bit. Weight gradients are summed a block at a time and then in the order of
the blocks: the same for any number of threads.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.utils.checkpoint import checkpoint

from core.appearance.encoding import encoded_places
from core.appearance.transfer_blocks import PANEL, QUAD, STRIP, differentiate, evaluate, padded
from core.threads import in_parallel

CHUNK_BYTES = 2 << 30  # half a million rows of the paper's width, two million of the default
ROWS = 8 * STRIP  # of a block: half a millisecond of work
NOTHING = np.empty((0, 0), np.float32)


class Layers(NamedTuple):
    """Weights (outputs, inputs) and biases: the first layer's for either part of the input, the further hidden ones', the
    output's. `skip_weight` has no columns where nothing skips the hidden layers."""

    learned_weight: Float[Tensor, "width learned"]
    place_weight: Float[Tensor, "width encoded"]
    first_bias: Float[Tensor, " width"]
    hidden_weights: Float[Tensor, "more width width"]
    hidden_biases: Float[Tensor, "more width"]
    output_weight: Float[Tensor, "out width"]
    skip_weight: Float[Tensor, "out skipping"]
    output_bias: Float[Tensor, " out"]


def plain_mlp(
    learned: Float[Tensor, "n learned"], means: Float[Tensor, "n 3"], layers: Layers, octaves: int, bound: float
) -> Float[Tensor, "n out"]:
    """The definition: any dtype, any device, differentiable by autograd but for the means. Outputs lie in [-bound, bound].

    means: scene frame. octaves: of the encoding of the contracted means, see core.appearance.encoding.
    """
    linear = torch.addmm  # a bias, or what is already there, plus a product: one kernel on a GPU
    hidden = linear(layers.first_bias, encoded_places(means, octaves), layers.place_weight.T)
    hidden = torch.relu(linear(hidden, learned, layers.learned_weight.T))
    for weight, bias in zip(layers.hidden_weights, layers.hidden_biases):
        hidden = torch.relu(linear(bias, hidden, weight.T))
    output = linear(layers.output_bias, hidden, layers.output_weight.T)
    if layers.skip_weight.shape[1]:
        output = linear(output, learned, layers.skip_weight.T)
    return bound * torch.tanh(output / bound)


def chunked_mlp(
    learned: Float[Tensor, "n learned"], means: Float[Tensor, "n 3"], layers: Layers, octaves: int, bound: float
) -> Float[Tensor, "n out"]:
    """`plain_mlp` within CHUNK_BYTES: rows that do not fit go in chunks, of which the backward pass computes each again."""
    inputs = learned.shape[1] + layers.place_weight.shape[1]
    # Kept for the backward pass: both inputs, each hidden layer before and after its ReLU, and three steps of the output.
    kept = inputs + 2 * len(layers.first_bias) * (1 + len(layers.hidden_weights)) + 3 * len(layers.output_bias)
    rows = max(1, CHUNK_BYTES // (kept * learned.element_size()))
    if len(learned) <= rows:
        return plain_mlp(learned, means, layers, octaves, bound)
    parts = zip(learned.split(rows), means.split(rows))
    options = {"use_reentrant": False, "preserve_rng_state": False}
    return torch.cat([checkpoint(plain_mlp, *part, layers, octaves, bound, **options) for part in parts])


def blockwise_mlp(
    learned: Float[Tensor, "n learned"], means: Float[Tensor, "n 3"], layers: Layers, octaves: int, bound: float
) -> Float[Tensor, "n out"]:
    """`plain_mlp` for float32 on the CPU, on torch.get_num_threads() threads."""
    return _BlockwiseMLP.apply(torch.is_grad_enabled(), learned, means.detach(), octaves, bound, *layers)


@torch.no_grad()
def blockwise_sum(
    base: Float[Tensor, "n out"],
    learned: Float[Tensor, "n learned"],
    means: Float[Tensor, "n 3"],
    layers: Layers,
    octaves: int,
    bound: float,
    into: Float[Tensor, "n out"],
) -> None:
    """base + blockwise_mlp(...), the same bits, written into the contiguous `into`: without a gradient, in one pass."""
    _forward(learned, means, octaves, bound, layers, _array_of(base), False, into.numpy())


def _forward(
    learned: Tensor, means: Tensor, octaves: int, bound: float, layers: Layers, base: np.ndarray, keeps: bool, output: np.ndarray
) -> np.ndarray:
    """Write the output; return the hidden layers (layers, padded rows, padded width), without rows unless it `keeps` them."""
    weights = [_padded(turned) for turned in _turned(layers)]
    # Kept for the backward pass: 4 * layers * width bytes a Gaussian. Computing it again instead took 15 % more of a step.
    rows = padded(len(learned), STRIP) if keeps else 0
    kept = np.empty((1 + len(layers.hidden_weights), rows, weights[0].shape[1]), np.float32)
    given = _array_of(learned), _array_of(means), octaves, np.float32(bound), base
    in_parallel(lambda begin, end: evaluate(begin, end, *given, *weights, kept, output), len(learned), ROWS)
    return kept


class _BlockwiseMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx, training: bool, learned: Tensor, means: Tensor, octaves: int, bound: float, *weights: Tensor) -> Tensor:
        layers = Layers(*weights)
        output = learned.new_empty(len(learned), len(layers.output_bias))
        kept = _forward(learned, means, octaves, bound, layers, NOTHING, training, output.numpy())
        if training:
            ctx.save_for_backward(learned, means, output, *weights)
            ctx.octaves, ctx.bound, ctx.kept = octaves, bound, kept
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx, output_gradient: Tensor):
        learned, means, output, *weights = ctx.saved_tensors
        layers = Layers(*weights)
        wants_learned, wants = ctx.needs_input_grad[1], ctx.needs_input_grad[5:]
        back = layers.learned_weight, layers.hidden_weights, layers.output_weight, layers.skip_weight
        learned_gradient = np.empty(learned.shape if wants_learned else (0, 0), np.float32)
        given = _array_of(learned), _array_of(means), ctx.octaves, np.float32(ctx.bound), _array_of(output)
        given += _array_of(output_gradient), ctx.kept, *map(_padded, back), learned_gradient
        # A block adds into sums of its own, which are then added in the order of the blocks.
        turned = _turned(layers)
        shapes = [_padded_shape(weight) if wanted else (0,) * weight.dim() for weight, wanted in zip(turned, wants)]
        sums = [np.zeros((-(-len(learned) // ROWS), *shape), np.float32) for shape in shapes]
        in_parallel(
            lambda begin, end: differentiate(begin, end, *given, *(part[begin // ROWS] for part in sums)), len(learned), ROWS
        )
        totals = [torch.from_numpy(part.sum(axis=0)) for part in sums]
        cut = [total[tuple(map(slice, weight.shape))] for total, weight in zip(totals, turned)]
        gradients = (gradient if wanted else None for gradient, wanted in zip(_turned(Layers(*cut)), wants))
        return None, torch.from_numpy(learned_gradient) if wants_learned else None, None, None, None, *gradients


def _turned(layers: Layers) -> Layers:
    """Weights as (inputs, outputs), or back again; biases as they are."""
    return Layers(*(part.mT if name.endswith(("weight", "weights")) else part for name, part in zip(Layers._fields, layers)))


def _padded_shape(weight: Tensor) -> tuple[int, ...]:
    """The shape in which `differentiate` sums a turned weight's gradient: whole panels, and whole quads of rows."""
    *more, columns = weight.shape
    return *more[:-1], *(padded(rows, QUAD) for rows in more[-1:]), padded(columns, PANEL)


def _padded(weight: Tensor) -> np.ndarray:
    """The weight with zeros behind its columns, to whole panels."""
    array = weight.detach().numpy()
    result = np.zeros((*array.shape[:-1], padded(array.shape[-1], PANEL)), np.float32)
    result[..., : array.shape[-1]] = array
    return result


def _array_of(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()
