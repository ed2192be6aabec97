"""The appearance model: from a photo to its embedding and mask, and from an embedding to the Gaussians in that look."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from core.appearance.colouring import UNCHANGED, Weights
from core.appearance.encoder import PhotoEncoder, PlainMask, mask_shape, shrink
from core.appearance.exposure import ExposureTransfer
from core.appearance.known_range import KnownRange
from core.appearance.mask_table import MaskTable
from core.appearance.sh_transfer import SHTransfer, TransferInput
from core.config import Settings
from core.errors import BadInput, BadSetting
from core.scene.splats import Splats
from core.system.threads import one_torch_thread

TABLE_SPREAD = 1.0  # of GLO embeddings at the start; the strongest component of an encoder's has 0.7
MEAN_WINDOW_ROUNDS = 2  # the mean embedding forgets over this many rounds through the photos,
LEAST_WINDOW = 64  # and this many steps: over fewer, the exposure jitter of single photos shows in the neutral look


@dataclass(frozen=True)
class Reading:
    """What the model reads from a photo: its embedding and its mask (1 = static, 0 = transient,
    at 1/4 of the shrunk photo's size, rounded up)."""

    embedding: Float[Tensor, " e"]
    mask: Float[Tensor, "1 h w"] | None

    def detached(self) -> "Reading":
        """The same without a gradient, sharing memory."""
        return Reading(self.embedding.detach(), None if self.mask is None else self.mask.detach())


class AppearanceModel(nn.Module):
    """All that is learned about looks, built from the settings; parts that are switched off do not exist.

    photo_names: the training photos; row i of any table (GLO embeddings, MLP masks, met_embeddings) is that of
    photo_names[i].
    """

    # The running mean over training steps (`remember`), which is the neutral look; zeros before the first step.
    mean_embedding: Tensor
    # Each photo's embedding when it was last trained on, or, until then, the first photo's; no rows unless an encoder
    # gives embeddings.
    met_embeddings: Tensor
    final_embeddings: Tensor | None  # two rows per photo, see `use_final_embeddings`; not in the state dict
    remembered: Tensor

    def __init__(self, settings: Settings, photo_names: Sequence[str]):
        super().__init__()
        if settings.undecided:
            raise BadSetting(
                f"{settings.undecided[0]} is not decided yet.", "Give it, or let core.training.decisions decide."
            )
        self.settings = settings
        self.photo_names = tuple(photo_names)
        self.encoder = None
        self.embedding_table = None
        self.mask_network: PlainMask | MaskTable | None = None
        self.sh_transfer = None
        if settings.encodes_photos or (settings.has_masks and settings.mask == "attention"):
            self.encoder = PhotoEncoder(settings)
        if settings.has_looks and not settings.encodes_photos:
            size = len(self.photo_names), settings.embedding_size
            self.embedding_table = nn.Parameter(TABLE_SPREAD * torch.randn(size))
        if settings.has_masks and settings.mask == "cnn":
            self.mask_network = PlainMask()
        if settings.has_masks and settings.mask == "mlp":
            self.mask_network = MaskTable(len(self.photo_names))
        if settings.has_looks:
            self.sh_transfer = (SHTransfer if settings.appearance == "full" else ExposureTransfer)(settings)
        self.register_buffer("mean_embedding", torch.zeros(settings.embedding_size))
        rows = len(self.photo_names) if settings.encodes_photos else 0
        self.register_buffer("met_embeddings", torch.zeros(rows, settings.embedding_size))
        self.register_buffer("final_embeddings", None, persistent=False)
        self.register_buffer("remembered", torch.zeros((), dtype=torch.int64))

    def _apply(self, function, recurse: bool = True) -> "AppearanceModel":
        """As torch's, which `to` calls, but `remembered` stays on the CPU:
        reading it on a GPU would make every step wait."""
        super()._apply(function, recurse)
        self.remembered = self.remembered.cpu()
        return self

    def row_of(self, photo_name: str) -> int | None:
        """The photo's place in `photo_names`; None for a photo that was not trained on."""
        return self.photo_names.index(photo_name) if photo_name in self.photo_names else None

    def read(self, picture: Float[Tensor, "3 h w"], row: int | None = None) -> Reading:
        """The embedding and mask of a photo of the scene.

        picture: [0, 1], any size; it is shrunk here, and one that is shrunk already stays as it is. row: see `row_of`.
        The embedding of a photo without one is held within `known_range`; with a GLO table its embedding is the mean,
        where a refinement can start. Without appearance the embedding is the mean too (zeros). Raises BadInput for a
        row that does not exist.
        """
        if row is not None and not 0 <= row < len(self.photo_names):
            raise BadInput(f"There is no photo {row} among {len(self.photo_names)}.", "Count from 0.")
        picture = shrink(picture, self.settings.encoder_side_px)
        embedding = mask = None
        with one_torch_thread():  # a few ms of work: more threads cost more than they save, and would round differently
            if self.encoder is not None:
                embedding, mask = self.encoder(picture)
                if embedding is not None and row is None:
                    embedding = self.known_range().nearest(embedding)
            if self.embedding_table is not None and row is not None:
                embedding = self.embedding_table[row]
            if isinstance(self.mask_network, PlainMask):
                mask = self.mask_network(picture)
            elif self.mask_network is not None and row is not None:
                mask = self.mask_network(row, *mask_shape(picture))
        return Reading(self.mean_embedding if embedding is None else embedding, mask)

    @torch.no_grad()
    def embedding_from_outside(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, " e"]:
        """The embedding of a photo from outside the collection, not held within `known_range`;
        the mean where no encoder gives any.

        Encoded with M := 1 (paper, section V-G): in a photo of another place the mask may hide the night sky.
        """
        if self.encoder is None:
            return self.mean_embedding
        with one_torch_thread():
            embedding, _ = self.encoder(shrink(picture, self.settings.encoder_side_px), masked=False)
        return self.mean_embedding if embedding is None else embedding

    @torch.no_grad()
    def encode_training_photos(
        self, pictures: Iterable[Float[Tensor, "3 h w"]]
    ) -> tuple[Float[Tensor, "k e"], Float[Tensor, "k e"]]:
        """The embeddings of the training photos, in the order of their rows:
        as photos of the collection, and as from outside.

        `met_embeddings` differ from these: they come from earlier weights and from photos in random exposures.
        """
        both = [
            (self.read(picture, row).embedding, self.embedding_from_outside(picture))
            for row, picture in enumerate(pictures)
        ]
        masked, unmasked = zip(*both)
        return torch.stack(masked), torch.stack(unmasked)

    def use_final_embeddings(self, masked: Float[Tensor, "k e"], unmasked: Float[Tensor, "k e"]) -> None:
        """Use what `encode_training_photos` gave at the end of training as `known_embeddings`,
        so that `known_range` holds the training photos read either way."""
        self.final_embeddings = torch.cat([masked, unmasked])

    def transfer(
        self, base: TransferInput, embedding: Float[Tensor, " e"], changes: Weights = UNCHANGED
    ) -> tuple[Float[Tensor, "v c 3"], Float[Tensor, "v c 3"] | None]:
        """(sh', residual): the coefficients in a look, and what was added to the base to get them.

        changes: of the SH transfer's weights, in a look that has some. The residual is None where there is none to
        regularise: without appearance (sh' is the base SH itself), and where the transfer predicts sh' directly
        (`residual` off).
        """
        if self.sh_transfer is None:
            return base.sh, None
        output = self.sh_transfer(base, embedding, changes)
        return (base.sh + output, output) if self.predicts_residuals else (output, None)

    @property
    def predicts_residuals(self) -> bool:
        """Whether `transfer` adds a residual to the base, which can be regularised."""
        return self.sh_transfer is not None and (self.settings.appearance != "full" or self.settings.residual)

    def given_spread(self) -> Weights:
        """The standard deviation, over the training photos, of the weights that embeddings give;
        see SHTransfer.given_spread."""
        with one_torch_thread():  # more would round differently
            return UNCHANGED if self.sh_transfer is None else self.sh_transfer.given_spread(self.known_embeddings)

    @property
    def hidden_weights(self) -> Weights:
        """See SHTransfer.hidden_weights."""
        return UNCHANGED if self.sh_transfer is None else self.sh_transfer.hidden_weights

    def transfer_parameters(self) -> list[nn.Parameter]:
        """The weights of the SH transfer, or of what stands in for it."""
        return [] if self.sh_transfer is None else list(self.sh_transfer.parameters())

    @torch.no_grad()
    def bake(
        self,
        splats: Splats,
        embedding: Float[Tensor, " e"],
        latents: Float[Tensor, "n l"] | None = None,
        changes: Weights = UNCHANGED,
    ) -> Splats:
        """The Gaussians in one look, without a gradient;
        for float32 on the CPU, the SH are those of `transfer`, bit for bit."""
        splats = splats.detached()
        given = TransferInput(splats.sh, splats.means, latents), embedding, changes
        if self.sh_transfer is not None and self.predicts_residuals:
            return splats.with_sh(self.sh_transfer.base_plus_residual(*given))
        return splats.with_sh(self.transfer(*given)[0])

    @property
    def known_embeddings(self) -> Float[Tensor, "k e"]:
        """The embeddings of the training photos: finished ones, else the table's, else as last met.
        No rows without appearance and before training."""
        if self.final_embeddings is not None:
            return self.final_embeddings
        known = self.met_embeddings if self.embedding_table is None else self.embedding_table.detach()
        return known if self.remembered else known[:0]

    def known_range(self) -> KnownRange:
        """Where embeddings may lie: anywhere while none is known.
        Costs a singular value decomposition of the known ones."""
        return KnownRange.of(self.known_embeddings)

    @torch.no_grad()
    def remember(self, embedding: Float[Tensor, " e"], row: int) -> None:
        """Let the embedding of a training photo enter `met_embeddings` and `mean_embedding`.

        The mean is an exponential moving average with bias correction. With decay d the t-th embedding enters with
        weight (1 - d) / (1 - d^t), 1 for the first: the correction of Adam (Kingma & Ba 2015, section 3), written for
        the corrected mean.
        """
        if not self.remembered:
            self.met_embeddings[:] = embedding
        if len(self.met_embeddings):
            self.met_embeddings[row] = embedding
        self.remembered += 1
        decay = 1 - 1 / max(MEAN_WINDOW_ROUNDS * len(self.photo_names), LEAST_WINDOW)
        weight = (1 - decay) / (1 - decay ** int(self.remembered))
        # A new tensor, not a change in place: looks and graphs that hold the old mean keep their value.
        self.mean_embedding = torch.lerp(self.mean_embedding, embedding, weight)
