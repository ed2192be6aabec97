"""Many small kernels started as one: a network whose inputs have the same shapes each time, as CUDA graphs.

A GPU is through with a small kernel sooner than the host has started the next. A graph is recorded once and then started whole.
"""

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.func import functional_call

WARM_UP = 3  # calls before one is recorded: in them kernels are compiled, and libraries take the memory that they work in

Results = tuple[Tensor | None, ...]


class Replayed:
    """`network` as it is, but on a GPU, where gradients are asked for, from graphs for each set of shapes; so is its backward pass.

    network: of tensors alone, whose values it does not wait for; it gives a tuple, and its weights keep their places in memory. The gradients
    of weights lie where the next backward pass writes its own: they are to be used, and set to None, before.
    """

    def __init__(self, network: nn.Module):
        self.network = network
        self.recordings: dict[tuple, _Recording] = {}

    def __call__(self, *given: Tensor) -> Results:
        if not (can_record(given[0].device) and torch.is_grad_enabled()):
            return self.network(*given)
        shapes = tuple(tensor.shape for tensor in given)
        if shapes not in self.recordings:
            self.recordings[shapes] = _Recording(self.network, given)
        recording = self.recordings[shapes]
        results = iter(_Replay.apply(recording, *given, *recording.weights))
        return tuple(next(results) if exists else None for exists in recording.exists)


def can_record(device: torch.device) -> bool:
    """Whether kernels on this device can be recorded."""
    return device.type == "cuda"


class _Recording:
    """The graphs, and the tensors that they read and write.

    given: inputs. results: those that are not None, as `exists` says, with result_gradients, None for one without. gradients: of inputs and
    weights, None likewise.
    """

    def __init__(self, network: nn.Module, given: tuple[Tensor, ...]):
        self.network = network
        self.given = [tensor.detach().clone().requires_grad_(tensor.requires_grad) for tensor in given]
        self.weights = list(network.parameters())
        # In the same memory, but strangers to autograd, which would wait for the stream that a weight was first used on.
        self.aliases = {name: weight.detach().requires_grad_() for name, weight in network.named_parameters()}
        before, aside = torch.cuda.current_stream(), torch.cuda.Stream()
        aside.wait_stream(before)
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                self._warm_up()
        before.wait_stream(aside)
        self.forward_graph, self.backward_graph = torch.cuda.CUDAGraph(), torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.forward_graph):
            results = self._forward()
        with torch.cuda.graph(self.backward_graph, pool=self.forward_graph.pool()):
            found = iter(self._backward(results))
        self.results = [result.detach() for result in results if result is not None]
        self.gradients = [next(found) if tensor.requires_grad else None for tensor in self._inputs()]

    def _inputs(self) -> tuple[Tensor, ...]:
        return *self.given, *self.aliases.values()

    def _forward(self) -> Results:
        return functional_call(self.network, self.aliases, tuple(self.given))

    def _backward(self, results: Results) -> tuple[Tensor | None, ...]:
        taught = [result for result in results if result is not None and result.requires_grad]
        learned = [tensor for tensor in self._inputs() if tensor.requires_grad]
        return torch.autograd.grad(taught, learned, [each for each in self.result_gradients if each is not None], allow_unused=True)

    def _warm_up(self) -> None:
        results = self._forward()
        self.exists = [result is not None for result in results]
        self.result_gradients = [torch.zeros_like(result) if result.requires_grad else None for result in results if result is not None]
        self._backward(results)


class _Replay(torch.autograd.Function):
    @staticmethod
    def forward(ctx, recording: _Recording, *inputs: Tensor) -> Results:
        ctx.recording = recording
        for place, tensor in zip(recording.given, inputs):
            place.copy_(tensor)
        recording.forward_graph.replay()
        results = tuple(result.clone() for result in recording.results)
        ctx.mark_non_differentiable(*(result for result, gradient in zip(results, recording.result_gradients) if gradient is None))
        return results

    @staticmethod
    @once_differentiable
    def backward(ctx, *result_gradients: Tensor):
        recording = ctx.recording
        for place, gradient in zip(recording.result_gradients, result_gradients):
            if place is not None:
                place.copy_(gradient)
        recording.backward_graph.replay()
        return None, *(None if gradient is None else gradient.detach() for gradient in recording.gradients)
