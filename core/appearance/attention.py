"""Channel attention and the U-Net that predicts the mask, which is spatial attention as well (paper, section IV-B)."""

from typing import TypeVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

Layer = TypeVar("Layer", bound=nn.Module)

REDUCTION = 4  # hidden units of the channel attention are this many times fewer than its channels
STATIC_LOGIT = 3.0  # masks start near sigmoid(3) = 0.95, so that nothing is hidden before something was learned,
LAST_LAYER_GAIN = 0.1  # and nearly flat: the last layer's initial weights are scaled by this


def he_initialised(layer: Layer) -> Layer:
    """`layer` with weights that keep the mean square of their input through a ReLU (He et al. 2015, eq. 10;
    PyTorch's own leave a sixth of it).

    Not so of a transposed convolution, whose outputs PyTorch takes for its inputs: those of MaskUNet leave a quarter
    and, before LAST_LAYER_GAIN, sixteen times as much.
    """
    nn.init.kaiming_normal_(layer.get_parameter("weight"), nonlinearity="relu")
    nn.init.zeros_(layer.get_parameter("bias"))
    return layer


class ChannelAttention(nn.Module):
    """F' = sigmoid(MLP(average(F)) + MLP(maximum(F))) * F (paper, eqs. 15 and 16):
    one weight per channel, from one two-layer MLP.

    The paper writes the attention map as C x 1 x H'; pooling over space leaves C x 1 x 1.
    """

    def __init__(self, channels: int):
        super().__init__()
        hidden = channels // REDUCTION
        self.shared = nn.Sequential(nn.Linear(channels, hidden), nn.ReLU(), nn.Linear(hidden, channels))

    def forward(self, features: Float[Tensor, "1 c h w"]) -> Float[Tensor, "1 c h w"]:
        pooled = torch.cat([features.mean((2, 3)), features.amax((2, 3))])
        return features * torch.sigmoid(self.shared(pooled).sum(0))[None, :, None, None]


class MaskUNet(nn.Module):
    """M = UNet(F') (paper, eq. 17): two convolutions down, two transposed ones up, one skip;
    1 = static, 0 = transient."""

    def __init__(self, channels: int):
        super().__init__()
        self.down_1 = he_initialised(nn.Conv2d(channels, channels, 3, stride=2, padding=1))
        self.down_2 = he_initialised(nn.Conv2d(channels, channels, 3, stride=2, padding=1))
        # Kernels of 4 are a multiple of the stride: those of 3 leave a far stronger chequerboard in the mask.
        self.up_1 = he_initialised(nn.ConvTranspose2d(channels, channels, 4, stride=2, padding=1))
        self.up_2 = he_initialised(nn.ConvTranspose2d(2 * channels, 1, 4, stride=2, padding=1))
        with torch.no_grad():
            self.up_2.weight *= LAST_LAYER_GAIN
        nn.init.constant_(self.up_2.get_parameter("bias"), STATIC_LOGIT)

    def forward(self, features: Float[Tensor, "1 c h w"]) -> Float[Tensor, "1 1 h w"]:
        half = F.relu(self.down_1(features))
        quarter = F.relu(self.down_2(half))
        # Odd sizes: halving rounds up, so doubling gives a row or column too many, which is cut off.
        up = F.relu(self.up_1(quarter))[:, :, : half.shape[2], : half.shape[3]]
        logits = self.up_2(torch.cat([up, half], dim=1))
        return torch.sigmoid(logits[:, :, : features.shape[2], : features.shape[3]])
