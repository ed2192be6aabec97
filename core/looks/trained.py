"""A trained run, ready to be looked at: its Gaussians, its appearance model, and its Gaussians in a look."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

import core.rasterizer
from core.appearance.colouring import Colouring, Weights, blended
from core.appearance.model import AppearanceModel
from core.appearance.reach import Reach
from core.appearance.refinement import FARTHEST
from core.appearance.tone import toned
from core.config import Settings
from core.data.collection import Collection, Photo
from core.data.sfm.kept_points import home_of
from core.errors import BadInput
from core.looks.smooth_sky import SmoothSky
from core.rasterizer import Colour, Rasterizer
from core.scene.camera import Camera
from core.scene.harmonics import SH_0
from core.scene.splats import Splats
from core.system import device
from core.training.background import background_of_figures
from core.training.gaussians.gaussians import Gaussians
from core.training.on_disk import checkpoint, run_config
from core.training.sized_photos import SizedPhoto, Sizes, load_sized_photo
from core.training.transparency import transparent_is_empty

UNSEEN_PX = 1.0  # what makes up less of a photo is not shown by it
NEUTRAL = "neutral"  # the name of the look that every run has; no other can have it


@dataclass(frozen=True)
class TrainedRun:
    """What `load_run` finds in a run folder.

    splats: base Gaussians, scene frame; the last `sky` of them are the dome. latents: one a Gaussian, if the run has any.
    seconds: spent on training. learned: the embeddings of the training photos, in the order of `model.photo_names`: a table's, or an encoder's
    once training is finished; the reach of looks is then made of these. It is a Subject of core.evaluation.
    """

    folder: Path
    identity: str
    settings: Settings
    collection: Collection
    step: int
    seconds: float
    splats: Splats
    sky: int
    latents: Float[Tensor, "n l"] | None
    model: AppearanceModel
    learned: Float[Tensor, "k e"] | None = None

    def sized_photo(self, photo: Photo) -> SizedPhoto:
        """A photo of the collection at its training size, with its camera and the encoder's input.

        Raises BadInput if the photo is missing or damaged.
        """
        root = self.collection.root
        if not photo.path.is_file() and not home_of(root).is_dir():
            raise run_config.scene_gone(self.folder, root, f"{photo.name} cannot be read")
        return load_sized_photo(photo, self.sizes, self.device, self.transparent_is_empty)

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

    def seen_by(self, camera: Camera) -> "RunView":
        """What the camera sees of it, in any look."""
        return RunView(self, camera)

    @cached_property
    def smooth_sky(self) -> SmoothSky | None:
        """What the colours of its dome become in every look; None without a dome that training photos show."""
        cameras = [self.camera(photo) for photo in self.collection.split("train")]
        return SmoothSky.of(self.splats, self.sky, cameras, self.rasterizer)

    @property
    def has_looks(self) -> bool:
        """Whether it has more looks than one."""
        return self.settings.appearance != "off"

    @cached_property
    def given_spread(self) -> Weights:
        """How widely the weights that embeddings give differ between its looks."""
        return self.model.given_spread

    @cached_property
    def reach(self) -> Reach:
        """Where the embeddings of its looks may lie."""
        return self.model.reach

    @cached_property
    def sizes(self) -> Sizes:
        """The sizes its photos were trained at."""
        return Sizes.of(self.settings, self.collection.photos)

    @property
    def transparent_is_empty(self) -> bool:
        """Whether transparent pixels were learned as empty space."""
        return transparent_is_empty(self.settings)

    @property
    def background(self) -> Colour:
        """What its pictures are shown and measured over."""
        return background_of_figures(self.transparent_is_empty)

    @property
    def device(self) -> torch.device:
        """Where the run is used."""
        return self.splats.means.device

    @cached_property
    def rasterizer(self) -> Rasterizer:
        """The backend that the run was trained with; for `auto`, or without the GPU it was trained on, the one for the device in use."""
        moved = self.settings.device == "cuda" and self.device.type == "cpu"
        return core.rasterizer.create("auto" if moved else self.settings.backend, self.device.type)

    @property
    def where(self) -> str:
        """Words for the user on the device in use, if the run was trained on a GPU; else nothing."""
        return f", on {device.named(self.device)}" if self.settings.device == "cuda" else ""


class RunView:
    """What one camera sees of a run in any look, as `bake` gives it: a core.appearance.refinement.Refinable."""

    def __init__(self, trained: TrainedRun, camera: Camera):
        self.trained, self.camera, self.has_looks = trained, camera, trained.has_looks
        self.given_spread, self.hidden = trained.given_spread, trained.model.hidden
        self.visible = trained.rasterizer.visible(trained.splats, camera)
        solid = self.solid = len(trained.splats) - trained.sky
        rows = self.visible.rows
        self.place, self.discs = rows[rows < solid], rows[rows >= solid] - solid
        self.smooth_sky = trained.smooth_sky if len(self.discs) else None
        self.sources = self._base(rows if self.smooth_sky is None else torch.cat([self.place, self.smooth_sky.shown + solid]))
        self.shown = trained.splats[rows].detached()

    def render(self, look: Colouring) -> Float[Tensor, "H W 3"]:
        """The view in this look."""
        sh = self._harmonics(*self.sources, look)
        if self.smooth_sky is not None:
            place = len(self.place)
            sh = torch.cat([sh[:place], self.smooth_sky.sh(sh[place:], self.discs)])
        seen = self.shown.with_sh(sh)
        if look.tone is not None:
            seen = toned(seen, look.tone, len(self.discs))
        return self.trained.rasterizer.render(seen, self.camera, self.trained.background, pairs=self.visible.pairs).image

    def harmonics(self, rows: Int[Tensor, " r"], look: Colouring) -> Float[Tensor, "r c 3"]:
        """The SH of these Gaussians in this look, before tone and smooth sky."""
        return self._harmonics(*self._base(rows), look)

    def _base(self, rows: Int[Tensor, " r"]) -> tuple[Splats, Float[Tensor, "r l"] | None]:
        trained = self.trained
        return trained.splats[rows].detached(), None if trained.latents is None else trained.latents[rows].detach()

    def _harmonics(self, base: Splats, latents: Float[Tensor, "r l"] | None, look: Colouring) -> Float[Tensor, "r c 3"]:
        return self.trained.model.transfer(base.sh, base.means, look.embedding, latents, look.changes)[0]

    def bound(self, embedding: Float[Tensor, " e"]) -> Float[Tensor, " e"]:
        """The embedding, or the nearest to it that a refinement may take."""
        return self.trained.reach.nearest(embedding, FARTHEST)

    def unseen(self, valid: Bool[Tensor, "H W"] | None) -> Int[Tensor, " r"]:
        """Rows of the Gaussians that make up less than UNSEEN_PX of these pixels in all: what lies out of view, behind something, or under a
        mask. A Gaussian's share of a picture is the gradient of that by its colour.
        """
        trained = self.trained
        with torch.enable_grad():
            grey = torch.zeros(len(self.shown), 1, 3, device=trained.device, requires_grad=True)
            image = trained.rasterizer.render(self.shown.with_sh(grey), self.camera, pairs=self.visible.pairs).image[..., 0]
            (image if valid is None else image * valid).sum().backward()
        seen = self.visible.rows[grey.grad[:, 0, 0] >= SH_0 * UNSEEN_PX]
        unseen = trained.splats.finite_rows()
        unseen[seen] = False
        return unseen.nonzero()[:, 0]

    @cached_property
    @torch.no_grad()
    def sky(self) -> Float[Tensor, "H W"] | None:
        """How much of each pixel is sky, [0, 1]; None without a dome."""
        trained = self.trained
        if not trained.sky:
            return None
        return trained.rasterizer.render(trained.splats.marked(slice(self.solid, None)), self.camera).image[..., 0].clamp(0, 1)


@dataclass(frozen=True)
class Look:
    """A look by name. source: where it comes from, in words."""

    name: str
    source: str
    colouring: Colouring


def load_run(folder: Path, on_gpu: bool = True) -> TrainedRun:
    """The newest checkpoint of a run folder, and all that is needed to use it; BadInput if there is none.

    on_gpu: if the run was trained on a GPU and there is one here, use it there; else on the CPU.
    """
    identity, settings, collection = run_config.read_config(folder)
    path = checkpoint.newest(folder)
    if path is None:
        raise BadInput(f"{folder} has no checkpoint yet.", f"Wait for its first one; if it was stopped, type: {checkpoint.how_to_go_on(folder)}")
    saved = checkpoint.load(path)
    place = device.of_run(settings.device) if on_gpu else device.CPU
    with checkpoint.fitting(path):
        gaussians = Gaussians.from_tensors(saved.part("gaussians"), saved.facts["sky"]).to(place)
        model = AppearanceModel(settings, saved.facts["photos"]).to(place)
        model.load_state_dict(saved.part("model"))
        encoded = {name: tensor.to(place) for name, tensor in saved.part("encoded").items()}
        if encoded:
            model.met_embeddings = torch.cat([encoded["masked"], encoded["unmasked"]])
        step, seconds = saved.facts["step"], saved.facts["trainer"]["seconds"]
        splats = gaussians.splats.detached()
    model.eval().requires_grad_(False)
    learned = encoded.get("masked") if model.embedding_table is None else model.embedding_table
    return TrainedRun(folder, identity, settings, collection, step, seconds, splats, gaussians.sky, gaussians.latents, model, learned)


def bake(trained: TrainedRun, look: Look, rows: Int[Tensor, " r"] | slice = slice(None)) -> Splats:
    """The Gaussians of the run in one look, scene frame: one pass of the SH transfer; appearance is over after it.

    rows: of those wanted, all by default; ascending, the whole dome among them.
    """
    embedding, tone, changes = look.colouring
    latents = None if trained.latents is None else trained.latents[rows]
    baked = trained.model.bake(trained.splats[rows], embedding, latents, changes)
    if trained.smooth_sky is not None:
        baked = trained.smooth_sky.over(baked)
    return baked if tone is None else toned(baked, tone, trained.sky)


def neutral_look(trained: TrainedRun) -> Look:
    """The look that every run has."""
    return Look(NEUTRAL, "the mean of the training photos", Colouring(trained.model.mean_embedding))


def blend(first: Look, last: Look, share: float) -> Look:
    """The look `share` of the way from `first` to `last`; at 0 and 1 exactly these, so that their bakes are equal."""
    if share in (0.0, 1.0):
        return last if share else first
    name = f"{share:.3f} of the way from {first.name} to {last.name}"
    return Look(name, name, blended(first.colouring, last.colouring, share))
