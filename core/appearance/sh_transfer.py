"""G_phi: from the base SH of a Gaussian and the embedding of a photo to the SH of that photo's look."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.encoding import contract, encode, encoded_size
from core.appearance.transfer_kernel import Layers, blockwise_mlp, plain_mlp
from core.config import Settings
from core.errors import BadInput
from core.scene.harmonics import coefficient_count
from core.threads import one_torch_thread

LAST_LAYER_SPREAD = 1e-3  # near zero: a run starts at the base look, and yet every layer has a gradient


class SHTransfer(nn.Module):
    """delta = bound * tanh(G(gamma(sh), gamma(mu), l) / bound): the paper's eq. for Delta sh_jk, a four-layer MLP.

    gamma(sh): the coefficients, with `sh_octaves` octaves. gamma(mu): centres contracted into [-1, 1], with
    `position_octaves` octaves. An optional latent of `latent_size` numbers a Gaussian is a further input. The view
    direction is none: only so can a look be baked into a file.

    Deliberate differences from the paper: the output is bounded; no gradient flows into the centres (colour is no
    reason to move a Gaussian, and a third of the first layer's backward pass is saved). The photo's share of the first
    layer is the same for all Gaussians and computed once.
    """

    def __init__(self, settings: Settings):
        super().__init__()
        self.settings = settings
        self.coefficients = 3 * coefficient_count(settings.sh_degree)
        self.columns = (
            encoded_size(self.coefficients, settings.sh_octaves) + settings.latent_size,
            encoded_size(3, settings.position_octaves),
            settings.embedding_size,
        )
        width = settings.transfer_width
        self.layers = nn.ModuleList(
            nn.Linear(*size) for size in ((sum(self.columns), width), (width, width), (width, width))
        )
        self.layers.append(nn.Linear(width, self.coefficients))
        for layer in self.layers:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(layer.bias)
        nn.init.normal_(self.layers[-1].weight, std=LAST_LAYER_SPREAD)

    def forward(
        self,
        sh: Float[Tensor, "v c 3"],
        means: Float[Tensor, "v 3"],
        embedding: Float[Tensor, " e"],
        latents: Float[Tensor, "v l"] | None = None,
    ) -> Float[Tensor, "v c 3"]:
        """The bounded output for each Gaussian: the residual of its SH, or its SH where `residual` is off.

        sh: base coefficients. means: scene frame, finite. latents: needed exactly if `latent_size` > 0. Differentiable in
        all but `means`, and in `sh` unless `detach_sh`. A row's result does not depend on the other rows (bit for
        bit for float32 on the CPU). Raises BadInput if the sizes are not those of the settings.
        """
        if sh.dtype == torch.float32 and sh.device.type == "cpu":
            with one_torch_thread():
                inputs = self.inputs(sh, means, embedding, latents)
            return blockwise_mlp(*inputs, self.settings.residual_bound).view_as(sh)
        inputs = self.inputs(sh, means, embedding, latents)
        return plain_mlp(*inputs, self.settings.residual_bound).view_as(sh)

    def inputs(
        self,
        sh: Float[Tensor, "v c 3"],
        means: Float[Tensor, "v 3"],
        embedding: Float[Tensor, " e"],
        latents: Float[Tensor, "v l"] | None = None,
    ) -> tuple[Float[Tensor, "v learned"], Float[Tensor, "v fixed"], Layers]:
        """What the MLP is evaluated on: columns with a gradient, columns without, layers with the embedding in bias 1."""
        latent_size = 0 if latents is None else latents.shape[1]
        for what, given, expected in (
            ("SH coefficients", sh.shape[1] * 3, self.coefficients),
            ("latent numbers", latent_size, self.settings.latent_size),
            ("embedding numbers", embedding.shape[0], self.settings.embedding_size),
        ):
            if given != expected:
                raise BadInput(
                    f"The SH transfer was trained on {expected} {what} and got {given}.",
                    "Use the settings that the run was trained with.",
                )
        base = (sh.detach() if self.settings.detach_sh else sh).flatten(1)
        learned = encode(base, self.settings.sh_octaves) if self.settings.sh_octaves else base
        if latents is not None:
            learned = torch.cat([learned, latents], dim=1)
        fixed = encode(contract(means.detach()), self.settings.position_octaves)
        first, second, third, last = self.layers
        learned_weight, fixed_weight, embedding_weight = first.weight.split(self.columns, dim=1)
        layers = Layers(
            learned_weight,
            fixed_weight,
            embedding_weight @ embedding + first.bias,
            second.weight,
            second.bias,
            third.weight,
            third.bias,
            last.weight,
            last.bias,
        )
        return learned, fixed, layers
