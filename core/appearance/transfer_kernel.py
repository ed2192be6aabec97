"""The MLP inside the SH transfer: the definition in plain torch, and the same in blocks for the CPU.

h_1 = relu(x W_1' + b_1), h_i = relu(h_(i-1) W_i' + b_i), y = bound * tanh((h_n V' + x_learned S' + b) / bound). The input x comes
in two parts: `learned` columns, which receive a gradient and may also skip to the output, and the encoded places of the Gaussians,
which do neither.

Blocks keep what is at work in cache and let threads share the rows. Every block has ROWS rows, the last one padded, because a BLAS rounds a row differently in a matrix of another height: so a row's result does not depend on
what it is evaluated with, and bakes equal live renders bit for bit. Weight gradients are summed a block at a time and
then in the order of the blocks: the same for any number of threads.
"""

import threading
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.appearance.encoding import contract, encode, encoded_size
from core.appearance.transfer_arithmetic import bound_softly, encode_places
from core.threads import in_parallel

ROWS = 2048  # fewer cost more calls, more leave the cache; from 1024 to 4096 all are within a tenth of each other


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
    places = encode(contract(means.detach()), octaves)
    hidden = torch.relu(learned @ layers.learned_weight.T + places @ layers.place_weight.T + layers.first_bias)
    for weight, bias in zip(layers.hidden_weights, layers.hidden_biases):
        hidden = torch.relu(hidden @ weight.T + bias)
    output = hidden @ layers.output_weight.T + layers.output_bias
    if layers.skip_weight.shape[1]:
        output = output + learned @ layers.skip_weight.T
    return bound * torch.tanh(output / bound)


def blockwise_mlp(
    learned: Float[Tensor, "n learned"], means: Float[Tensor, "n 3"], layers: Layers, octaves: int, bound: float
) -> Float[Tensor, "n out"]:
    """`plain_mlp` for float32 on the CPU, on torch.get_num_threads() threads."""
    means = means.detach().contiguous()
    return _BlockwiseMLP.apply(torch.is_grad_enabled(), learned.contiguous(), means, octaves, bound, *layers)


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
    """base + blockwise_mlp(...), the same bits, written into `into`: without a gradient, and each block while it is in cache."""
    learned, means = learned.contiguous(), means.contiguous()
    scratch = base.new_empty(1 + len(layers.hidden_weights), 0, len(layers.first_bias))

    def add(begin: int, end: int) -> None:
        rows = slice(begin, end)
        block = _evaluate(_padded("learned", learned[rows]), means[rows], layers, octaves, bound, _hidden_blocks(scratch, rows))
        torch.add(base[rows], block[: end - begin], out=into[rows])

    in_parallel(add, len(learned), ROWS)


def _evaluate(
    inputs: Tensor, means: Tensor, layers: Layers, octaves: int, bound: float, hidden: tuple[Tensor, ...]
) -> Tensor:
    """The output of a block of ROWS rows, in a buffer; the layers in between are written into `hidden`."""
    torch.addmm(layers.first_bias, inputs, layers.learned_weight.T, out=hidden[0])
    hidden[0].addmm_(_places(means, octaves), layers.place_weight.T).relu_()
    for number, (weight, bias) in enumerate(zip(layers.hidden_weights, layers.hidden_biases)):
        torch.addmm(bias, hidden[number], weight.T, out=hidden[number + 1]).relu_()
    block = _buffer("output", len(layers.output_bias))
    torch.addmm(layers.output_bias, hidden[-1], layers.output_weight.T, out=block)
    if layers.skip_weight.shape[1]:
        block.addmm_(inputs, layers.skip_weight.T)
    bound_softly(block.view(-1).numpy(), np.float32(bound))
    return block


class _BlockwiseMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx, training: bool, learned: Tensor, means: Tensor, octaves: int, bound: float, *weights: Tensor) -> Tensor:
        layers = Layers(*weights)
        output = learned.new_empty(len(learned), len(layers.output_bias))
        depth, width = 1 + len(layers.hidden_weights), len(layers.first_bias)
        # Kept for the backward pass: 4 * depth * width bytes a Gaussian. Computing it again instead took 15 % more of a step.
        kept = learned.new_empty(depth, _blocks(len(learned)) * ROWS if training else 0, width)

        def evaluate(begin: int, end: int) -> None:
            rows = slice(begin, end)
            inputs, hidden = _padded("learned", learned[rows]), _hidden_blocks(kept, rows)
            output[rows] = _evaluate(inputs, means[rows], layers, octaves, bound, hidden)[: end - begin]

        in_parallel(evaluate, len(learned), ROWS)
        if training:
            ctx.save_for_backward(learned, means, kept, output, *weights)
            ctx.octaves, ctx.bound = octaves, bound
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx, output_gradient: Tensor):
        learned, means, kept, output, *weights = ctx.saved_tensors
        layers = Layers(*weights)
        wants_learned, wants = ctx.needs_input_grad[1], ctx.needs_input_grad[5:]
        output_gradient = output_gradient.contiguous()
        learned_gradient = torch.empty_like(learned) if wants_learned else None
        sizes = [weight.numel() if wanted else 0 for weight, wanted in zip(weights, wants)]
        partial_sums = learned.new_empty(_blocks(len(learned)), sum(sizes))

        def by_weight(sums: Tensor) -> Layers:
            parts = zip(sums.split(sizes), weights, wants)
            return Layers(*(part.view(weight.shape) if wanted else None for part, weight, wanted in parts))

        def differentiate(begin: int, end: int) -> None:
            rows = slice(begin, end)
            into = by_weight(partial_sums[rows.start // ROWS])
            inputs = _padded("learned", learned[rows])
            hidden = _hidden_blocks(kept, rows)
            before_output = _before_bound(output[rows], output_gradient[rows], ctx.bound)
            _add_up(before_output, hidden[-1], into.output_weight, into.output_bias)
            _add_up(before_output, inputs, into.skip_weight)
            before = _before_layer("before output", before_output, hidden[-1], layers.output_weight)
            for number in reversed(range(len(layers.hidden_weights))):
                sums = (part if part is None else part[number] for part in (into.hidden_weights, into.hidden_biases))
                _add_up(before, hidden[number], *sums)
                before = _before_layer(f"before {number}", before, hidden[number], layers.hidden_weights[number])
            _add_up(before, inputs, into.learned_weight, into.first_bias)
            _add_up(before, _places(means[rows], ctx.octaves), into.place_weight)
            if wants_learned:
                block = _buffer("learned gradient", learned.shape[1])
                torch.mm(before, layers.learned_weight, out=block)
                if layers.skip_weight.shape[1]:
                    block.addmm_(before_output, layers.skip_weight)
                learned_gradient[rows] = block[: rows.stop - rows.start]

        in_parallel(differentiate, len(learned), ROWS)
        return None, learned_gradient, None, None, None, *by_weight(_sum_in_order(partial_sums))


def _add_up(gradient: Tensor, inputs: Tensor, weight: Tensor | None, bias: Tensor | None = None) -> None:
    """One block's gradient of a layer's weight and bias, where they are wanted."""
    if weight is not None and weight.numel():
        torch.mm(gradient.T, inputs, out=weight)
    if bias is not None:
        torch.sum(gradient, 0, out=bias)


def _blocks(rows: int) -> int:
    return -(-rows // ROWS)


def _hidden_blocks(kept: Tensor, rows: slice) -> tuple[Tensor, ...]:
    """One block of every hidden layer (depth, padded rows, width), or scratch where none are kept."""
    if kept.shape[1]:
        return kept[:, rows.start : rows.start + ROWS].unbind(0)
    return tuple(_buffer(f"hidden {number}", kept.shape[2]) for number in range(len(kept)))


def _before_bound(output: Tensor, output_gradient: Tensor, bound: float) -> Tensor:
    """d/dy of bound * tanh(y / bound) = 1 - (output / bound)^2, times the incoming gradient; zero in padded rows."""
    block = _buffer("before bound", output.shape[1])
    block[len(output) :] = 0
    torch.mul(output, output, out=block[: len(output)])
    block[: len(output)].mul_(-1 / bound**2).add_(1).mul_(output_gradient)
    return block


def _before_layer(name: str, gradient: Tensor, inputs: Tensor, weight: Tensor) -> Tensor:
    """The gradient behind a layer -> the one before the ReLU that made the layer's inputs."""
    before = _buffer(name, weight.shape[1])
    torch.mm(gradient, weight, out=before)
    return torch.ops.aten.threshold_backward.grad_input(before, inputs, 0, grad_input=before)


class _Buffers(threading.local):
    """Each thread's scratch blocks by name and columns; kept, because fresh pages cost more than the arithmetic."""

    def __init__(self):
        self.blocks: dict[tuple[str, int], Tensor] = {}


_buffers = _Buffers()


def _buffer(name: str, columns: int) -> Tensor:
    key = (name, columns)
    if key not in _buffers.blocks:
        _buffers.blocks[key] = torch.empty(ROWS, columns)
    return _buffers.blocks[key]


def _padded(name: str, rows: Tensor) -> Tensor:
    """A block of ROWS rows: `rows` themselves, or a copy that ends in zeros."""
    if len(rows) == ROWS:
        return rows
    block = _buffer(name, rows.shape[1])
    block[: len(rows)] = rows
    block[len(rows) :] = 0
    return block


def _places(means: Tensor, octaves: int) -> Tensor:
    """The encoded places of a block's Gaussians; zero in padded rows."""
    columns = encoded_size(3, octaves)
    transposed = _buffer("places", columns).view(columns, ROWS)
    encode_places(means.numpy(), octaves, transposed.numpy())
    return transposed.T


def _sum_in_order(partial_sums: Tensor) -> Tensor:
    """The sum over blocks, added one after the other whatever the number of threads."""
    total = partial_sums.new_zeros(partial_sums.shape[1])
    for part in partial_sums:
        total += part
    return total
