"""A trained run, ready to be looked at: its Gaussians, its appearance model, and its Gaussians in a look."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

import core.rasterizer
from core.appearance.colouring import Colouring, Weights, blended
from core.appearance.known_range import KnownRange
from core.appearance.model import AppearanceModel
from core.appearance.sh_transfer import TransferInput
from core.appearance.tone import toned
from core.config import Settings
from core.data.collection import Collection, Photo
from core.errors import BadInput
from core.looks.run_view import RunView
from core.looks.smooth_sky import SmoothSky
from core.rasterizer import Colour, Rasterizer
from core.run import checkpoint, run_config
from core.run.background import background_of_figures
from core.run.run_state import RunState
from core.run.sized_photo import SizedPhoto, Sizes, load_sized_photo
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system import device
from core.training.gaussians.gaussians import Gaussians

NEUTRAL = "neutral"  # the name of the look that every run has; no other can have it


@dataclass(frozen=True)
class TrainedRun:
    """What `load_run` finds in a run folder.

    splats: base Gaussians, scene frame; the last `sky_count` of them are the dome. latents: one row a Gaussian, if the
    run has any. state: where it stood at the checkpoint. photo_embeddings: (k, e), row i for `model.photo_names[i]`,
    from the GLO table or from the encoder as it was at the end of training; None while the encoder's training is
    unfinished, and without looks. A TrainedRun is a Subject of core.evaluation.
    """

    folder: Path
    identity: str
    settings: Settings
    collection: Collection
    state: RunState
    splats: Splats
    sky_count: int
    latents: Float[Tensor, "n l"] | None
    model: AppearanceModel
    photo_embeddings: Float[Tensor, "k e"] | None = None

    @property
    def solid_count(self) -> int:
        """The number of Gaussians that are not sky."""
        return len(self.splats) - self.sky_count

    @property
    def step(self) -> int:
        """Steps done."""
        return self.state.done

    @property
    def seconds(self) -> float:
        """Spent on training."""
        return self.state.seconds

    def sized_photo(self, photo: Photo) -> SizedPhoto:
        """A photo of the collection at its training size, with its camera and the encoder's input.

        Raises BadInput if the photo is missing or damaged.
        """
        if not photo.path.is_file() and not self.collection.root.is_dir():
            raise run_config.scene_gone(self.folder, self.collection, f"{photo.name} cannot be read")
        return load_sized_photo(photo, self.sizes, self.device, self.settings.transparent_is_empty)

    def camera(self, photo: Photo) -> Camera:
        """The camera of a photo of the collection at its training size; the photo itself is not needed."""
        return self.sizes.camera(photo)

    @torch.no_grad()
    def embed(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, " e"]:
        """The embedding of a picture ([0, 1], any size) that was not trained on."""
        return self.model.read(picture).embedding

    @torch.no_grad()
    def mask(self, picture: Float[Tensor, "3 h w"]) -> Float[Tensor, "h4 w4"] | None:
        """The mask of a picture, 1 = static; None if the run has no mask network."""
        mask = self.model.read(picture).mask
        return None if mask is None else mask[0]

    def base(self, rows: Int[Tensor, " r"] | Bool[Tensor, " n"] | slice) -> TransferInput:
        """What the SH transfer reads of these Gaussians, in any look."""
        return TransferInput(self.splats.sh[rows], self.splats.means[rows], self.latents_of(rows))

    def latents_of(self, rows: Int[Tensor, " r"] | Bool[Tensor, " n"] | slice) -> Float[Tensor, "r l"] | None:
        """The latents of these Gaussians, if the run has any."""
        return None if self.latents is None else self.latents[rows]

    def seen_by(self, camera: Camera) -> RunView:
        """What the camera sees of the run, in any look."""
        return RunView(self, camera)

    @cached_property
    def smooth_sky(self) -> SmoothSky | None:
        """What the colours of its dome become in every look; None without a dome that training photos show."""
        cameras = [self.camera(photo) for photo in self.collection.split("train")]
        return SmoothSky.of(self.splats, self.sky_count, cameras, self.rasterizer)

    @property
    def has_looks(self) -> bool:
        """Whether it has more looks than one."""
        return self.settings.has_looks

    @cached_property
    def given_spread(self) -> Weights:
        """How widely the weights that embeddings give differ between its looks."""
        return self.model.given_spread()

    @cached_property
    def known_range(self) -> KnownRange:
        """Where the embeddings of its looks may lie."""
        return self.model.known_range()

    @cached_property
    def sizes(self) -> Sizes:
        """The sizes its photos were trained at."""
        return Sizes.of(self.settings, self.collection.photos)

    @property
    def background(self) -> Colour:
        """What its pictures are shown and measured over."""
        return background_of_figures(self.settings.transparent_is_empty)

    @property
    def device(self) -> torch.device:
        """Where the run is used."""
        return self.splats.means.device

    @cached_property
    def rasterizer(self) -> Rasterizer:
        """The backend that the run was trained with;
        for `auto`, or without the GPU it was trained on, the one for the device in use."""
        moved = self.settings.device == "cuda" and self.device.type == "cpu"
        return core.rasterizer.create("auto" if moved else self.settings.backend, self.device.type)

    @property
    def on_device_in_words(self) -> str:
        """Words for the user on the device in use, if the run was trained on a GPU; else nothing."""
        return f", on {device.named(self.device)}" if self.settings.device == "cuda" else ""


@dataclass(frozen=True)
class Look:
    """A look by name. source: where it comes from, in words."""

    name: str
    source: str
    colouring: Colouring


def load_run(folder: Path, on_gpu: bool = True) -> TrainedRun:
    """The newest checkpoint of a run folder, and all that is needed to use it; BadInput if there is none.

    on_gpu: use the run on a GPU, if it was trained on one and there is one here; otherwise it is used on the CPU.
    """
    identity, settings, collection = run_config.read_config(folder)
    found = checkpoint.read_newest(folder, checkpoint.load)
    if found is None:
        raise BadInput(
            f"{folder} has no checkpoint yet.",
            f"Wait for its first one; if it was stopped, type: {checkpoint.how_to_go_on(folder)}",
        )
    path, saved = found
    run_device = device.of_run(settings.device) if on_gpu else device.CPU
    with checkpoint.fitting(path):
        gaussians = Gaussians.from_tensors(saved.part("gaussians"), saved.facts["sky"]).to(run_device)
        model = AppearanceModel(settings, saved.facts["photos"]).to(run_device)
        model.load_state_dict(saved.part("model"))
        encoded = {name: tensor.to(run_device) for name, tensor in saved.part("encoded").items()}
        if encoded:
            model.use_final_embeddings(encoded["masked"], encoded["unmasked"])
        state = RunState.of_facts(saved.facts)
        splats = gaussians.splats.detached()
    model.eval().requires_grad_(False)
    photo_embeddings = encoded.get("masked") if model.embedding_table is None else model.embedding_table
    return TrainedRun(
        folder=folder,
        identity=identity,
        settings=settings,
        collection=collection,
        state=state,
        splats=splats,
        sky_count=gaussians.sky_count,
        latents=gaussians.latents,
        model=model,
        photo_embeddings=photo_embeddings,
    )


def bake(trained: TrainedRun, look: Look, rows: Int[Tensor, " r"] | slice = slice(None)) -> Splats:
    """The Gaussians of the run in one look, scene frame, by one pass of the SH transfer.
    What follows knows nothing of appearance.

    rows: those that are wanted, all by default; ascending, the whole dome among them.
    """
    embedding, tone, changes = look.colouring
    baked = trained.model.bake(trained.splats[rows], embedding, trained.latents_of(rows), changes)
    if trained.smooth_sky is not None:
        baked = trained.smooth_sky.over(baked)
    return baked if tone is None else toned(baked, tone, trained.sky_count)


def drawn(trained: TrainedRun, baked: Splats, camera: Camera) -> Float[Tensor, "h w 3"]:
    """The run in a baked look, as the camera sees it; not clamped at 1."""
    return trained.rasterizer.render(baked, camera, trained.background)


def neutral_look(trained: TrainedRun) -> Look:
    """The look that every run has."""
    return Look(NEUTRAL, "the neutral look (mean of the training photos)", Colouring(trained.model.mean_embedding))


def blend(first: Look, last: Look, share: float) -> Look:
    """The look `share` of the way from `first` to `last`;
    at 0 and 1 exactly these two, so that their bakes are equal."""
    if share in (0.0, 1.0):
        return last if share else first
    name = f"{share:.3f} of the way from {first.name} to {last.name}"
    return Look(name, name, blended(first.colouring, last.colouring, share))
