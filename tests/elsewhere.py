"""A device that is not the CPU, on a machine that has no other: tensors that say `meta` and have their numbers all the same.

With it a test finds tensors that were left on the CPU: an operation that mixes the devices raises, as it would on a GPU. It
says nothing of what a GPU computes; the numbers are the CPU's.
"""

from contextlib import contextmanager

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
        if kwargs.get("device") is None and not any(isinstance(leaf, Elsewhere) for leaf in tree_flatten((args, kwargs))[0]):
            return function(*args, **kwargs)
        return run(function, args, kwargs)


@contextmanager
def elsewhere():
    """Inside, tensors made on DEVICE or moved to it are Elsewhere."""
    with _Factories():
        yield


def run(function, args, kwargs):
    """The operation on the numbers that are kept; its results are where torch would put them."""
    leaves = [leaf for leaf in tree_flatten((args, kwargs))[0] if isinstance(leaf, Tensor)]
    there = any(isinstance(leaf, Elsewhere) for leaf in leaves)
    moves = function in (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)
    # torch lets single numbers of the CPU take part in anything.
    left = [leaf for leaf in leaves if not isinstance(leaf, Elsewhere) and leaf.dim()]
    if there and left and not moves:
        raise MixedDevices(f"{function} got {[tuple(leaf.shape) for leaf in left]} on the CPU and others elsewhere.")
    target = kwargs.get("device")
    if target is not None:
        there, kwargs = torch.device(target) == DEVICE, kwargs | {"device": "cpu"}
    kept = tree_map(lambda leaf: leaf.kept if isinstance(leaf, Elsewhere) else leaf, (args, kwargs))
    if function is torch.ops.aten._to_copy.default and kwargs.get("dtype") is None:
        result = kept[0][0].clone()
    else:
        result = function(*kept[0], **kept[1])
    given = {id(leaf.kept): leaf for leaf in leaves if isinstance(leaf, Elsewhere)}

    def placed(leaf):
        if not isinstance(leaf, Tensor) or not there:
            return leaf
        return given.get(id(leaf)) if id(leaf) in given else Elsewhere(leaf)  # what worked in place gives its own back

    return tree_map(placed, result)
