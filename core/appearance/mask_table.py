"""The ablation's MLP mask: memorised for each photo, as in Ha-NeRF; it knows nothing of photos it has not seen."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.attention import LAST_LAYER_GAIN, STATIC_LOGIT, he_initialised
from core.appearance.positional_encoding import encode, encoded_size

PHOTO_SIZE = 32  # learned numbers per photo
WIDTH = 64
OCTAVES = 6  # of the pixel's position; the finest is 1/32 of the picture, about the mask's own pixels


class MaskTable(nn.Module):
    """M(u, v) = sigmoid(MLP(photo's numbers, gamma(u), gamma(v))), u and v in [-1, 1]; 1 = static."""

    def __init__(self, photos: int):
        super().__init__()
        self.photos = nn.Parameter(torch.randn(photos, PHOTO_SIZE))
        self.hidden = nn.ModuleList(
            he_initialised(nn.Linear(inputs, WIDTH)) for inputs in (PHOTO_SIZE + encoded_size(2, OCTAVES), WIDTH)
        )
        self.last = he_initialised(nn.Linear(WIDTH, 1))
        with torch.no_grad():
            self.last.weight *= LAST_LAYER_GAIN
        nn.init.constant_(self.last.bias, STATIC_LOGIT)

    def forward(self, row: int, height: int, width: int) -> Float[Tensor, "1 {height} {width}"]:
        """The mask of the photo in this row at a size in pixels."""
        rows, columns = (
            (torch.arange(size, device=self.photos.device, dtype=self.photos.dtype) * 2 + 1) / size - 1
            for size in (height, width)
        )
        positions = torch.cartesian_prod(rows, columns)
        code = self.photos[row].expand(len(positions), -1)
        values = torch.cat([code, encode(positions, OCTAVES)], dim=1)
        for layer in self.hidden:
            values = torch.relu(layer(values))
        return torch.sigmoid(self.last(values)).view(1, height, width)
