"""What every backend of kernels asks of its input: kernels do not look where they read."""

import torch
from torch import Tensor

from core.errors import LESS_MEMORY, BadInput
from core.scene.camera import Camera
from core.scene.harmonics import coefficient_count
from core.scene.splats import Splats


class ListsTooLarge(BadInput):
    """A picture whose tile lists take more memory than they may."""


def check(splats: Splats, probe: Tensor | None, backend: str, device: str) -> None:
    """Raise BadInput unless all is float32, on a `device` ("cpu" or "cuda"), the same one, and of matching shapes."""
    count = len(splats)
    shapes = {
        "means": (count, 3),
        "quaternions": (count, 4),
        "log_scales": (count, 3),
        "logit_opacities": (count,),
        "sh": (count, coefficient_count(splats.degree), 3),
        "probe": (count, 2),
    }
    for name, tensor in (splats.tensors() | ({} if probe is None else {"probe": probe})).items():
        here = tensor.device.type == device and tensor.device == splats.means.device
        if tensor.dtype != torch.float32 or not here:
            raise BadInput(
                f"The {backend} rasterizer got {name} as {tensor.dtype} on {tensor.device}.",
                f"Give it float32 on {'the CPU' if device == 'cpu' else 'one GPU'}, or use the reference.",
            )
        if tensor.shape != shapes[name]:
            raise BadInput(f"{name} has the shape {tuple(tensor.shape)}.", f"{count} means ask for {shapes[name]}.")


def check_lists(count: int, pairs: int, bytes_a_pair: int, budget: float, camera: Camera) -> None:
    """Raise ListsTooLarge if the tile lists of a picture, of so many pairs of a Gaussian and a tile,
    take more bytes than the budget."""
    if pairs * bytes_a_pair > budget:
        raise ListsTooLarge(
            f"{count} Gaussians cover {pairs} tiles of the {camera.width}x{camera.height} picture in all: "
            f"{pairs * bytes_a_pair / 2**30:.1f} GiB of lists.",
            f"{LESS_MEMORY}.",
        )
