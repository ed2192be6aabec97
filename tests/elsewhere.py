"""A device that is not the CPU, on a machine that has no other:
tensors that say `meta` and have their numbers all the same.

With it a test finds tensors that were left on the CPU: an operation that mixes the devices raises, as it would on a
GPU. It says nothing of what a GPU computes; the numbers are the CPU's. `watched` counts what the host would start there
and wait for.
"""

from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = torch.device("meta")


class Elsewhere(Tensor):
    """A tensor on DEVICE. kept: its numbers, on the CPU."""

    @staticmethod
    def __new__(cls, kept: Tensor):
        return Tensor._make_wrapper_subclass(
            cls, kept.size(), strides=kept.stride(), dtype=kept.dtype, device=DEVICE, requires_grad=False
        )

    def __init__(self, kept: Tensor):
        self.kept = kept

    def __repr__(self, **_):
        return f"Elsewhere({self.kept})"

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        return run(function, args, kwargs or {})


class MixedDevices(AssertionError):
    """An operation got tensors of both devices."""


class _Factories(TorchDispatchMode):
    """Sends what is made on DEVICE, or moved there, to `run` as well."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if kwargs.get("device") is None and not any(
            isinstance(leaf, Elsewhere) for leaf in tree_flatten((args, kwargs))[0]
        ):
            return function(*args, **kwargs)
        return run(function, args, kwargs)


@contextmanager
def elsewhere():
    """Inside, tensors made on DEVICE or moved to it are Elsewhere."""
    with _Factories():
        yield


aten = torch.ops.aten
# What torch answers only when the device has: their results have sizes, or are numbers, that the host has to know.
ANSWERS = {
    *(aten._local_scalar_dense.default, aten.nonzero.default, aten.masked_select.default, aten.equal.default),
    *(aten._unique2.default, aten.unique_consecutive.default, aten.repeat_interleave.Tensor),
}
MOVES = {aten._to_copy.default, aten.copy_.default}
# Views and memory alone: nothing runs.
NO_KERNEL = {
    *(
        "view",
        "_unsafe_view",
        "reshape",
        "slice",
        "select",
        "split",
        "split_with_sizes",
        "unbind",
        "permute",
        "transpose",
        "t",
    ),
    *(
        "expand",
        "detach",
        "alias",
        "squeeze",
        "unsqueeze",
        "as_strided",
        "empty",
        "empty_like",
        "new_empty",
        "lift_fresh",
    ),
    *("empty_strided", "new_empty_strided", "_reshape_alias", "set_", "resize_", "is_same_size", "result_type"),
}


@dataclass
class Work:
    """launches: kernels by name, an operation of torch that is no view as one; triton: those of ours among them. waits:
    what the host would wait for. asked: what it asked for without waiting, and has not waited for anything since."""

    launches: Counter = field(default_factory=Counter)
    triton: Counter = field(default_factory=Counter)
    waits: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def wait(self, name: str) -> None:
        self.waits.append(name)
        self.asked.clear()


_watching: list[Work] = []


@contextmanager
def watched():
    """Gives the Work that is done on DEVICE inside."""
    _watching.append(Work())
    try:
        yield _watching[-1]
    finally:
        _watching.pop()


def note(work: Work, function, args, kwargs, comes: bool, goes: bool) -> None:
    """comes, goes: whether the operation takes a tensor that is on DEVICE, and leaves one there."""
    name = str(function).removeprefix("aten.")
    selects = function in (
        aten.index.Tensor,
        aten.index_put_.default,
        aten.index_put.default,
        aten._index_put_impl_.default,
    )
    masks = selects and any(index is not None and index.dtype in (torch.bool, torch.uint8) for index in args[1])
    if function in MOVES and comes != goes:
        sent_on = kwargs.get("non_blocking", False) or (function is aten.copy_.default and len(args) > 2 and args[2])
        if not sent_on:
            work.wait(name)
        elif comes:
            work.asked.append(name)
    elif function in ANSWERS or masks:
        work.wait(name)
    elif name.split(".")[0] not in NO_KERNEL:
        work.launches[name] += 1


@contextmanager
def kernels():
    """Inside, Triton's interpreter runs kernels on the numbers that are kept;
    a GPU could not reach those of another tensor."""
    from triton.runtime.interpreter import GridExecutor

    original = GridExecutor.__call__

    def launch(self, *args, **kwargs):
        left = [leaf for leaf in tree_flatten(args)[0] if isinstance(leaf, Tensor) and not isinstance(leaf, Elsewhere)]
        if left:
            raise MixedDevices(f"{self.fn.__name__} got {[tuple(leaf.shape) for leaf in left]} on the CPU.")
        for work in _watching:
            work.triton[self.fn.__name__] += 1
            work.launches[self.fn.__name__] += 1
        original(self, *tree_map(lambda arg: arg.kept if isinstance(arg, Elsewhere) else arg, args), **kwargs)

    GridExecutor.__call__ = launch
    try:
        yield
    finally:
        GridExecutor.__call__ = original


def run(function, args, kwargs):
    """The operation on the numbers that are kept; its results are where torch would put them."""
    leaves = [leaf for leaf in tree_flatten((args, kwargs))[0] if isinstance(leaf, Tensor)]
    there = any(isinstance(leaf, Elsewhere) for leaf in leaves)
    # torch lets single numbers of the CPU take part in anything.
    left = [leaf for leaf in leaves if not isinstance(leaf, Elsewhere) and leaf.dim()]
    if there and left and function not in MOVES:
        raise MixedDevices(f"{function} got {[tuple(leaf.shape) for leaf in left]} on the CPU and others elsewhere.")
    target = kwargs.get("device")
    if target is not None:
        there, kwargs = torch.device(target) == DEVICE, kwargs | {"device": "cpu"}
    comes = any(isinstance(leaf, Elsewhere) for leaf in leaves)
    for work in _watching if comes or there else ():
        note(work, function, args, kwargs, comes, there)
    kept = tree_map(lambda leaf: leaf.kept if isinstance(leaf, Elsewhere) else leaf, (args, kwargs))
    if function is aten._to_copy.default and kwargs.get("dtype") is None:
        result = kept[0][0].clone()
    else:
        result = function(*kept[0], **kept[1])
    given = {id(leaf.kept): leaf for leaf in leaves if isinstance(leaf, Elsewhere)}

    def placed(leaf):
        if not isinstance(leaf, Tensor) or not there:
            return leaf
        return given.get(id(leaf)) if id(leaf) in given else Elsewhere(leaf)  # what worked in place gives its own back

    return tree_map(placed, result)
