"""The MLP inside the SH transfer: the definition in plain torch, and the same in blocks for the CPU.

y = bound * tanh((h_3 W_4' + b_4) / bound), h_i = relu(h_(i-1) W_i' + b_i), with the first layer's input in two parts:
`learned` columns, which receive a gradient, and `fixed` ones, which do not.

Blocks keep what is at work in cache and let threads share the rows. Every block has ROWS rows, the last one padded, because a BLAS rounds a row differently in a matrix of another height: so a row's result does not depend on
what it is evaluated with, and bakes equal live renders bit for bit. Weight gradients are summed a block at a time and
then in the order of the blocks: the same for any number of threads.
"""

import threading
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from core.threads import in_parallel

ROWS = 2048  # fewer cost more calls, more leave the cache; from 1024 to 4096 all are within a tenth of each other


class Layers(NamedTuple):
    """Weights (outputs, inputs) and biases of the four layers; `bias_1` already holds the embedding's part."""

    learned_weight: Float[Tensor, "width learned"]
    fixed_weight: Float[Tensor, "width fixed"]
    bias_1: Float[Tensor, " width"]
    weight_2: Float[Tensor, "width width"]
    bias_2: Float[Tensor, " width"]
    weight_3: Float[Tensor, "width width"]
    bias_3: Float[Tensor, " width"]
    weight_4: Float[Tensor, "out width"]
    bias_4: Float[Tensor, " out"]


def plain_mlp(
    learned: Float[Tensor, "n learned"], fixed: Float[Tensor, "n fixed"], layers: Layers, bound: float
) -> Float[Tensor, "n out"]:
    """The definition: any dtype, any device, differentiable by autograd. Outputs lie in [-bound, bound]."""
    hidden = torch.relu(learned @ layers.learned_weight.T + fixed @ layers.fixed_weight.T + layers.bias_1)
    hidden = torch.relu(hidden @ layers.weight_2.T + layers.bias_2)
    hidden = torch.relu(hidden @ layers.weight_3.T + layers.bias_3)
    return bound * torch.tanh((hidden @ layers.weight_4.T + layers.bias_4) / bound)


def blockwise_mlp(
    learned: Float[Tensor, "n learned"], fixed: Float[Tensor, "n fixed"], layers: Layers, bound: float
) -> Float[Tensor, "n out"]:
    """`plain_mlp` for float32 on the CPU, on torch.get_num_threads() threads; no gradient into `fixed`."""
    return _BlockwiseMLP.apply(torch.is_grad_enabled(), learned.contiguous(), fixed.contiguous(), bound, *layers)


class _BlockwiseMLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx, training: bool, learned: Tensor, fixed: Tensor, bound: float, *weights: Tensor) -> Tensor:
        layers = Layers(*weights)
        output = learned.new_empty(len(learned), len(layers.bias_4))
        # Kept for the backward pass: 12 * width bytes a Gaussian. Computing it again instead took 15 % more of a step.
        hidden = learned.new_empty(3, _blocks(len(learned)) * ROWS if training else 0, len(layers.bias_1))

        def evaluate(begin: int, end: int) -> None:
            rows = slice(begin, end)
            first, second, third = _hidden_blocks(hidden, rows)
            torch.addmm(layers.bias_1, _padded("learned", learned[rows]), layers.learned_weight.T, out=first)
            first.addmm_(_padded("fixed", fixed[rows]), layers.fixed_weight.T).relu_()
            torch.addmm(layers.bias_2, first, layers.weight_2.T, out=second).relu_()
            torch.addmm(layers.bias_3, second, layers.weight_3.T, out=third).relu_()
            block = _buffer("output", output.shape[1])
            torch.addmm(layers.bias_4, third, layers.weight_4.T, out=block)
            block.div_(bound).tanh_()
            torch.mul(block[: rows.stop - rows.start], bound, out=output[rows])

        in_parallel(evaluate, len(learned), ROWS)
        if training:
            ctx.save_for_backward(learned, fixed, hidden, output, *weights)
            ctx.bound = bound
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx, output_gradient: Tensor):
        learned, fixed, hidden, output, *weights = ctx.saved_tensors
        layers = Layers(*weights)
        wants_learned, wants = ctx.needs_input_grad[1], ctx.needs_input_grad[4:]
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
            inputs_1 = _padded("learned", learned[rows]), _padded("fixed", fixed[rows])
            first, second, third = _hidden_blocks(hidden, rows)
            before_4 = _before_bound(output[rows], output_gradient[rows], ctx.bound)
            before_3 = _before_layer("before 3", before_4, third, layers.weight_4)
            before_2 = _before_layer("before 2", before_3, second, layers.weight_3)
            before_1 = _before_layer("before 1", before_2, first, layers.weight_2)
            for gradient, inputs, weight_sum in (
                (before_4, third, into.weight_4),
                (before_3, second, into.weight_3),
                (before_2, first, into.weight_2),
                (before_1, inputs_1[0], into.learned_weight),
                (before_1, inputs_1[1], into.fixed_weight),
            ):
                if weight_sum is not None:
                    torch.mm(gradient.T, inputs, out=weight_sum)
            for gradient, bias_sum in (
                (before_4, into.bias_4),
                (before_3, into.bias_3),
                (before_2, into.bias_2),
                (before_1, into.bias_1),
            ):
                if bias_sum is not None:
                    torch.sum(gradient, 0, out=bias_sum)
            if wants_learned:
                block = _buffer("learned gradient", learned.shape[1])
                torch.mm(before_1, layers.learned_weight, out=block)
                learned_gradient[rows] = block[: rows.stop - rows.start]

        in_parallel(differentiate, len(learned), ROWS)
        return None, learned_gradient, None, None, *by_weight(_sum_in_order(partial_sums))


def _blocks(rows: int) -> int:
    return -(-rows // ROWS)


def _hidden_blocks(hidden: Tensor, rows: slice) -> tuple[Tensor, Tensor, Tensor]:
    """One block of the three hidden layers (3, padded rows, width), or scratch where none are kept."""
    if hidden.shape[1]:
        return hidden[:, rows.start : rows.start + ROWS].unbind(0)
    return tuple(_buffer(name, hidden.shape[2]) for name in ("hidden 1", "hidden 2", "hidden 3"))


def _before_bound(output: Tensor, output_gradient: Tensor, bound: float) -> Tensor:
    """d/dy of bound * tanh(y / bound) = 1 - (output / bound)^2, times the incoming gradient; zero in padded rows."""
    block = _buffer("before 4", output.shape[1])
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


def _sum_in_order(partial_sums: Tensor) -> Tensor:
    """The sum over blocks, added one after the other whatever the number of threads."""
    total = partial_sums.new_zeros(partial_sums.shape[1])
    for part in partial_sums:
        total += part
    return total
