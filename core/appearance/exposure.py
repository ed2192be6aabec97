"""The light exposure mode: one affine colour map per look, for collections that differ by no more than that."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.colouring import UNCHANGED, Weights
from core.appearance.sh_transfer import TransferInput
from core.config import Settings
from core.scene.harmonics import SH_0


class ExposureTransfer(nn.Module):
    """colour' = A colour + b, with A = 1 + W_A l + c_A and b = W_b l + c_b:
    one linear layer with bias; initially the identity.

    colour = 0.5 + sum_c Y_c sh_c is linear in the coefficients, so the map is exact on them:
    sh' = A sh, and the DC coefficient also gets (A 0.5 + b - 0.5) / Y_0. (It maps colours before the clamp at 0.)
    """

    hidden_weights: Weights = UNCHANGED  # it has no hidden layers

    def __init__(self, settings: Settings):
        super().__init__()
        self.settings = settings
        self.map = nn.Linear(settings.embedding_size, 12)
        nn.init.zeros_(self.map.weight)
        nn.init.zeros_(self.map.bias)

    def forward(
        self, base: TransferInput, embedding: Float[Tensor, " e"], changes: Weights = UNCHANGED
    ) -> Float[Tensor, "v c 3"]:
        """The residual sh' - sh. Interface of SHTransfer; means and latents do not enter, and no look has changes."""
        sh = base.sh.detach() if self.settings.detach_sh else base.sh
        matrix, offset = self.change(embedding)
        # Not a matrix product: a BLAS rounds a row differently in chunks of another size.
        red, green, blue = sh.split(1, dim=2)
        residual = red * matrix[:, 0] + green * matrix[:, 1] + blue * matrix[:, 2]
        shift = (matrix.sum(1) * 0.5 + offset) / SH_0
        return residual + torch.cat([shift[None], residual.new_zeros(sh.shape[1] - 1, 3)])

    def change(self, embedding: Float[Tensor, " e"]) -> tuple[Float[Tensor, "3 3"], Float[Tensor, "3"]]:
        """(A - 1, b) of a look."""
        values = self.map(embedding).view(3, 4)
        return values[:, :3], values[:, 3]

    def base_plus_residual(self, base: TransferInput, *given) -> Float[Tensor, "v c 3"]:
        """The base SH plus `forward`."""
        return base.sh + self(base, *given)

    def given_spread(self, embeddings: Float[Tensor, "k e"]) -> Weights:
        """Embeddings give no weights."""
        return UNCHANGED
