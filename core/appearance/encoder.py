"""The encoder: one pass over a photo gives its embedding and its mask."""

from collections.abc import Iterable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.attention import ChannelAttention, MaskUNet, he_initialised
from core.config import Settings
from core.errors import BadInput
from core.system.threads import one_torch_thread

CHANNELS = (16, 32, 32)  # of Enc1; the paper gives none, these cost a few ms per photo on one core
WEAK_COMPONENT = 0.4  # of the strongest: what varies less between photos is amplified less
LEAST_CELL_WEIGHT = 1e-6  # of all cells, so that a band which the mask hides altogether has a colour, too
# Of the norm of the mean summary: variation below this is not light; photos of real collections vary by 0.1 and more.
ALIKE = 0.01


def shrink(photo: Float[Tensor, "3 h w"], side_px: int) -> Float[Tensor, "3 s s"]:
    """The photo ([0, 1]) squeezed by area to a square of `side_px`, or of its own short side where that is less.

    What the encoder learns of top and bottom, left and right, then holds for upright, wide and cropped photos alike.
    Training, evaluation and bake all use this, so an embedding does not depend on who computed it. Shrinking twice
    changes nothing. Raises BadInput for a photo without pixels.
    """
    height, width = photo.shape[1:]
    side = min(side_px, height, width)
    if side == 0:
        raise BadInput(f"The photo is {width} x {height} px.", "Use one that has pixels.")
    if height == width == side:
        return photo
    return F.interpolate(photo[None], size=(side, side), mode="area")[0]


def mask_shape(photo: Float[Tensor, "3 h w"]) -> tuple[int, int]:
    """Height and width of the mask of a shrunk photo: a quarter of its own, rounded up."""
    height, width = photo.shape[1:]
    return -(-height // 4), -(-width // 4)


class Enc1(nn.Sequential):
    """F = Enc1(I) (paper, eq. 14): three convolutions to 1/4 resolution, sizes rounded up."""

    def __init__(self):
        first, second, third = CHANNELS
        super().__init__(
            he_initialised(nn.Conv2d(3, first, 3, stride=2, padding=1)),
            nn.ReLU(),
            he_initialised(nn.Conv2d(first, second, 3, stride=2, padding=1)),
            nn.ReLU(),
            he_initialised(nn.Conv2d(second, third, 3, padding=1)),
            nn.ReLU(),
        )

    def forward(self, photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 c h4 w4"]:
        return super().forward(photo[None] * 2 - 1)


def band_colours(photo: Float[Tensor, "3 h w"], weight: Float[Tensor, "1 1 h4 w4"], bands: int) -> Float[Tensor, " b"]:
    """The mean colours of `bands` horizontal bands of the photo, red of all bands first.
    weight: how much each cell of 4 x 4 pixels counts."""
    if not bands:
        return photo.new_zeros(0)
    # Detached: a mask must not learn to hide things for the sake of the embedding.
    weight = weight.detach() + LEAST_CELL_WEIGHT
    height, width = weight.shape[2:]
    cells = F.adaptive_avg_pool2d(photo[None], (height, width))
    sums, weights = (F.adaptive_avg_pool2d(values, (bands, 1)) for values in (cells * weight, weight))
    return (sums / weights).flatten()


class Enc2(nn.Module):
    """l = Enc2(M * F' + F, I, M): three convolutions, the average over space, one linear layer to the embedding.

    The paper's eq. 19 has no I and M. Here the linear layer also sees the photo's colours from top to bottom
    (`band_colours`): learned features can memorise a collection's few photos, but how bright the sky and the ground are
    cannot be memorised.
    """

    def __init__(self, embedding_size: int, bands: int):
        super().__init__()
        self.bands = bands
        channels = CHANNELS[-1]
        self.convolutions = nn.ModuleList(
            he_initialised(nn.Conv2d(channels, channels, 3, stride=2, padding=1)) for _ in range(3)
        )
        self.embedding = nn.Linear(channels + 3 * bands, embedding_size)

    def summary(
        self, features: Float[Tensor, "1 c h4 w4"], photo: Float[Tensor, "3 h w"], static: Float[Tensor, "1 1 h4 w4"]
    ) -> Float[Tensor, " d"]:
        """The input of the linear layer. static: the mask that weighs the photo's colours."""
        colours = band_colours(photo, static, self.bands)
        for convolution in self.convolutions:
            features = F.relu(convolution(features))
        return torch.cat([features.mean((2, 3))[0], colours])

    def forward(
        self, features: Float[Tensor, "1 c h4 w4"], photo: Float[Tensor, "3 h w"], static: Float[Tensor, "1 1 h4 w4"]
    ) -> Float[Tensor, " e"]:
        return self.embedding(self.summary(features, photo, static))

    @torch.no_grad()
    def initialise_embedding(self, summaries: Float[Tensor, "photos d"]) -> None:
        """Initialise the last layer by principal components:
        the embeddings of these photos have mean zero and no correlation.

        Their strongest component varies by about 0.7 (standard deviation), the others by less.

        Embeddings that hardly differ leave the SH transfer nothing to learn from for most of a short run.
        Data-dependent initialisation after Mishkin & Matas 2016; weak components are amplified less, and where photos
        do not differ at all, nothing is divided by zero.
        """
        centre = summaries.mean(dim=0)
        _, strengths, directions = torch.linalg.svd(summaries - centre, full_matrices=False)
        kept = min(len(strengths), len(self.embedding.bias))
        deviations = strengths[:kept] / len(summaries) ** 0.5
        weight = summaries.new_zeros(self.embedding.weight.shape)
        least = torch.maximum(WEAK_COMPONENT * deviations[0], ALIKE * centre.norm())
        weight[:kept] = directions[:kept] / (deviations + least + 1e-6)[:, None]
        self.embedding.weight.copy_(weight)
        self.embedding.bias.copy_(-weight @ centre)


class PhotoEncoder(nn.Module):
    """F = Enc1(I), F' = CAM(F), M = UNet(F'), l = Enc2(M * F' + F, I, M);
    only the parts that the settings need are built.

    No Enc2 without appearance or with a GLO table; no UNet unless the mask is the attention (then M := 1); without
    transients neither UNet nor CAM, and l = Enc2(F, I, 1).
    """

    def __init__(self, settings: Settings):
        super().__init__()
        self.attends = settings.has_masks
        self.enc1 = Enc1()
        self.channel_attention = None
        self.unet = None
        self.enc2 = None
        if self.attends and settings.channel_attention:
            self.channel_attention = ChannelAttention(CHANNELS[-1])
        if self.attends and settings.mask == "attention":
            self.unet = MaskUNet(CHANNELS[-1])
        if settings.encodes_photos:
            self.enc2 = Enc2(settings.embedding_size, settings.colour_bands)

    def forward(
        self, photo: Float[Tensor, "3 h w"], masked: bool = True
    ) -> tuple[Float[Tensor, " e"] | None, Float[Tensor, "1 h4 w4"] | None]:
        """Embedding and mask (1 = static, at 1/4 of the photo's size, rounded up), each None if it is not built.

        photo: shrunk, [0, 1]. masked: whether the mask steers the embedding; if not, it is encoded with M := 1.
        """
        attended, static, mask = self.attend(photo, masked)
        embedding = self.enc2(attended, photo, static) if self.enc2 else None
        return embedding, None if mask is None else mask[0]

    def attend(
        self, photo: Float[Tensor, "3 h w"], masked: bool
    ) -> tuple[Float[Tensor, "1 c h4 w4"], Float[Tensor, "1 1 h4 w4"], Float[Tensor, "1 1 h4 w4"] | None]:
        """The features M * F' + F, the weights M in them, and the predicted mask, None without a U-Net.

        M is the mask, or 1 where there is none or `masked` is False.
        """
        features = self.enc1(photo)
        if not self.attends:
            return features, torch.ones_like(features[:, :1]), None
        refined = self.channel_attention(features) if self.channel_attention else features
        mask = self.unet(refined) if self.unet else None
        if masked and mask is not None:
            return features + mask * refined, mask, mask
        return features + refined, torch.ones_like(features[:, :1]), mask

    @torch.no_grad()
    def initialise_embedding(self, photos: Iterable[Float[Tensor, "3 h w"]]) -> None:
        """As Enc2.initialise_embedding, by what the encoder sees of these photos (shrunk)."""
        if self.enc2 is None:
            return
        with one_torch_thread():  # more would round the principal components differently
            summaries = []
            for photo in photos:
                attended, static, _ = self.attend(photo, masked=True)
                summaries.append(self.enc2.summary(attended, photo, static))
            self.enc2.initialise_embedding(torch.stack(summaries))


class PlainMask(nn.Module):
    """The ablation's CNN mask: the same layers as Enc1 and UNet, but apart from the encoder,
    so that the mask is nobody's attention."""

    def __init__(self):
        super().__init__()
        self.enc1 = Enc1()
        self.unet = MaskUNet(CHANNELS[-1])

    def forward(self, photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h4 w4"]:
        return self.unet(self.enc1(photo))[0]
