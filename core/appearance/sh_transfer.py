"""G_phi: from the base SH of a Gaussian and the embedding of a photo to the SH of that photo's look."""

from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.attention import he_initialised
from core.appearance.colouring import UNCHANGED, Weights
from core.appearance.positional_encoding import encode, encoded_size
from core.appearance.transfer_mlp import HiddenLayers, OutputLayer, blockwise_mlp, blockwise_sum, chunked_mlp
from core.config import Settings
from core.errors import BadInput
from core.scene.harmonics import coefficient_count
from core.system.threads import threads_for_blocks

LAST_LAYER_SPREAD = 1e-3  # near zero: a run starts at the base look, and yet every layer has a gradient
# One embedding moves every weight of the output layer; from 0.1 to 1 all are within 0.2 dB of each other.
MIXING_GAIN = 0.25


@dataclass(frozen=True)
class TransferInput:
    """What the SH transfer reads of V Gaussians.

    sh: base coefficients. means: scene frame, finite; they get no gradient. latents: needed exactly if the setting
    `latent_size` > 0.
    """

    sh: Float[Tensor, "v c 3"]
    means: Float[Tensor, "v 3"]
    latents: Float[Tensor, "v l"] | None = None


class SHTransfer(nn.Module):
    """delta = bound * tanh(G(gamma(sh), z, gamma(mu), l) / bound), G an MLP (paper, eq. 9: Delta sh_jk);
    sh' itself where `residual` is off.

    gamma(sh): the coefficients, with `sh_octaves` octaves. gamma(mu): centres contracted into [-1, 1], with
    `position_octaves` octaves. z: a latent of `latent_size` numbers per Gaussian, if that is not 0. The view direction
    is no input: only so can a look be baked into a file.

    `embedding_enters` "input": l is an input of the first layer, as in the paper; its share of that layer is the same
    for all Gaussians and computed once. "output": the hidden layers do not know the photo, and l gives the weights of
    the last one, a linear map V(l) of the hidden layer, of gamma(sh), of z and of 1. Residuals are then linear in l
    before the bound, sums of patterns that all photos share, as light is of its sources; a photo shows one side of a
    place, and so what it tells of the other side is better founded.

    Deliberate differences from the paper: the output is bounded; no gradient flows into the centres (colour is no
    reason to move a Gaussian, and a third of the first layer's backward pass is saved).
    """

    def __init__(self, settings: Settings):
        super().__init__()
        self.settings = settings
        self.coefficients = 3 * coefficient_count(settings.sh_degree)
        self.feature_columns = encoded_size(self.coefficients, settings.sh_octaves) + settings.latent_size
        self.mixes = settings.embedding_enters == "output"
        # Inputs of the first layer: the features, the place, and the embedding where it enters there.
        self.first_columns = (
            self.feature_columns,
            encoded_size(3, settings.position_octaves),
            0 if self.mixes else settings.embedding_size,
        )
        width = settings.transfer_width
        inputs = sum(self.first_columns), *(width,) * (settings.transfer_layers - 2)
        layers = [nn.Linear(columns, width) for columns in inputs]
        self.layers = nn.ModuleList(he_initialised(layer) for layer in layers)
        if self.mixes:
            self.last = nn.Linear(settings.embedding_size, self.coefficients * (width + self.feature_columns + 1))
        else:
            self.last = nn.Linear(width, self.coefficients)
        nn.init.normal_(self.last.weight, std=LAST_LAYER_SPREAD)
        nn.init.zeros_(self.last.bias)

    def forward(
        self, base: TransferInput, embedding: Float[Tensor, " e"], changes: Weights = UNCHANGED
    ) -> Float[Tensor, "v c 3"]:
        """The bounded output for each Gaussian: the residual of its SH, or its SH where `residual` is off.

        changes: added to the weights of these names for this call. Differentiable in everything but the means, and the
        base SH if `detach_sh`. A row's result does not depend on the other rows (bit for bit for float32 on the CPU).
        Raises BadInput if the sizes are not those of the settings.
        """
        self.check(base)
        sh, means, latents = base.sh, base.means, base.latents
        octaves, bound = self.settings.position_octaves, self.settings.residual_bound
        if not goes_blockwise(sh):
            layers = self.hidden_layers(embedding, changes), self.output_layer(embedding, changes)
            features = self.encoded(sh) if latents is None else torch.cat([self.encoded(sh), latents], dim=1)
            return chunked_mlp(features, means, *layers, octaves, bound).view_as(sh)
        with threads_for_blocks():
            encoded_sh, hidden_layers = self.encoded(sh), self.hidden_layers(embedding, changes)
            output_layer = partial(self.output_layer, embedding, changes)
            return blockwise_mlp(encoded_sh, latents, means, hidden_layers, output_layer, octaves, bound).view_as(sh)

    @torch.no_grad()
    def base_plus_residual(
        self, base: TransferInput, embedding: Float[Tensor, " e"], changes: Weights = UNCHANGED
    ) -> Float[Tensor, "v c 3"]:
        """The base SH plus `forward`, bit for bit; without a gradient, and on a CPU in one pass."""
        sh = base.sh
        if not goes_blockwise(sh):
            return sh + self(base, embedding, changes)
        self.check(base)
        octaves, bound = self.settings.position_octaves, self.settings.residual_bound
        with threads_for_blocks():
            layers = self.hidden_layers(embedding, changes), self.output_layer(embedding, changes)
            given = sh.flatten(1), self.encoded(sh), base.latents, base.means
            return blockwise_sum(*given, *layers, octaves, bound).view_as(sh)

    @torch.no_grad()
    def given_spread(self, embeddings: Float[Tensor, "k e"]) -> Weights:
        """How widely the output layers that these embeddings give differ (standard deviations);
        empty where an embedding is an input.

        By the name of the bias of the map that gives them: a change of it moves the output layers of all embeddings
        alike.
        """
        return {"last.bias": self.last(embeddings).std(dim=0)} if self.mixes and len(embeddings) > 1 else {}

    @property
    def hidden_weights(self) -> Weights:
        """Weights and biases of the hidden layers."""
        return {f"layers.{name}": weight.detach() for name, weight in self.layers.named_parameters()}

    def check(self, base: TransferInput) -> None:
        """Raise BadInput unless it has the sizes of the settings."""
        require("SH coefficients", base.sh.shape[1] * 3, self.coefficients)
        require("latent numbers", 0 if base.latents is None else base.latents.shape[1], self.settings.latent_size)

    def encoded(self, sh: Float[Tensor, "v c 3"]) -> Float[Tensor, "v g"]:
        """gamma(sh)."""
        base = (sh.detach() if self.settings.detach_sh else sh).flatten(1)
        return encode(base, self.settings.sh_octaves) if self.settings.sh_octaves else base

    def hidden_layers(self, embedding: Float[Tensor, " e"], changes: Weights = UNCHANGED) -> HiddenLayers:
        """The hidden layers of this photo."""
        require("embedding numbers", embedding.shape[0], self.settings.embedding_size)
        first_weight, first_bias, *further = [
            changed(weight, f"layers.{name}", changes) for name, weight in self.layers.named_parameters()
        ]
        feature_weight, position_weight, embedding_weight = first_weight.split(self.first_columns, dim=1)
        if not self.mixes:
            first_bias = embedding_weight @ embedding + first_bias
        width = len(first_bias)
        weights = torch.stack(further[::2]) if further else first_weight.new_empty(0, width, width)
        biases = torch.stack(further[1::2]) if further else first_weight.new_empty(0, width)
        return HiddenLayers(feature_weight, position_weight, first_bias, weights, biases)

    def output_layer(self, embedding: Float[Tensor, " e"], changes: Weights = UNCHANGED) -> OutputLayer:
        """The output layer of this photo."""
        weight, bias = changed(self.last.weight, "last.weight", changes), changed(self.last.bias, "last.bias", changes)
        if not self.mixes:
            return OutputLayer(weight, weight.new_empty(self.coefficients, 0), bias)
        mixed = MIXING_GAIN * F.linear(embedding, weight, bias).view(self.coefficients, -1)
        output_weight, skip_weight, output_bias = mixed.split(
            (self.layers[0].out_features, self.feature_columns, 1), dim=1
        )
        return OutputLayer(output_weight, skip_weight, output_bias.squeeze(1))


def changed(weight: Tensor, name: str, changes: Weights) -> Tensor:
    """The weight or bias `name`, plus its change if it has one."""
    return weight + changes[name] if name in changes else weight


def require(what: str, given: int, expected: int) -> None:
    """Raise BadInput unless `given` is the number of `what` that the transfer was trained on."""
    if given != expected:
        raise BadInput(
            f"The SH transfer was trained on {expected} {what} and got {given}.",
            "Use the settings that the run was trained with.",
        )


def goes_blockwise(sh: Tensor) -> bool:
    """Whether core.appearance.transfer_mlp computes it in blocks."""
    return sh.dtype == torch.float32 and sh.device.type == "cpu"
