"""A trained run, ready to be looked at: its Gaussians, its appearance model, and the looks it can take."""

import difflib
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

import core.rasterizer
from core import device
from core.appearance.encoder import shrink
from core.appearance.model import AppearanceModel, interpolate
from core.config import Settings
from core.data import photos as files
from core.data import sfm
from core.data.collection import Collection, Photo
from core.errors import BadInput
from core.rasterizer import Rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.training import checkpoint, run, saved_look
from core.training.gaussians import Gaussians
from core.training.pictures import Picture, auto_factor, load_picture, training_size
from core.training.saved_look import NEUTRAL

SMALLEST_PHOTO_PX = 16  # a short side below this says nothing about light that could be told from noise


@dataclass(frozen=True)
class Run:
    """What `load_run` finds in a run folder.

    splats: base Gaussians, scene frame; the last `sky` are the dome. latents: theirs, where the run has any. seconds: spent
    on training.
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

    def picture(self, photo: Photo) -> Picture:
        """A photo of the collection at the size it was trained at, with its camera and the encoder's input.

        Raises BadInput where the photo is missing or damaged.
        """
        root = self.collection.root
        if not root.is_dir():
            raise BadInput(f"{photo.name} cannot be read: the folder {root} is gone.", "Move the photos back to it.")
        return load_picture(photo, self.settings.resolution, self._factor, self.settings.encoder_side_px, self.device)

    def camera(self, photo: Photo) -> Camera:
        """The camera of a photo of the collection at the size it was trained at; the photo itself is not needed."""
        return photo.camera.resized(*training_size(photo, self.settings.resolution, self._factor))

    @property
    def device(self) -> torch.device:
        """Where the run is used."""
        return self.splats.means.device

    @property
    def rasterizer(self) -> Rasterizer:
        """The backend that the run was trained with; with `auto`, or where its GPU is missing, the one for where it is used."""
        moved = self.settings.device == "cuda" and self.device.type == "cpu"
        return core.rasterizer.create("auto" if moved else self.settings.backend, self.device.type)

    @property
    def where(self) -> str:
        """A few words for the user where the GPU, or its absence, is news; else nothing."""
        return f", on {device.named(self.device)}" if self.settings.device == "cuda" else ""

    @property
    def _factor(self) -> float:
        return auto_factor(self.collection.photos, "cuda" if self.settings.device == "cuda" else "cpu")


@dataclass(frozen=True)
class Appearance:
    """A look by name. source: what it was taken from, in words."""

    name: str
    source: str
    embedding: Float[Tensor, " e"]


def load_run(folder: Path, on_gpu: bool = True) -> Run:
    """The newest checkpoint of a run folder and all that is needed to use it; BadInput if there is none.

    on_gpu: use a run that was trained on a GPU there, if there is one here; else on the CPU.
    """
    identity, settings, collection = run.read_config(folder)
    path = checkpoint.newest(folder)
    if path is None:
        raise BadInput(f"{folder} has no checkpoint yet.", "Wait for its first one, or name another run.")
    saved = checkpoint.load(path)
    place = device.of_run(settings.device) if on_gpu else device.CPU
    with checkpoint.fitting(path):
        gaussians = Gaussians.from_tensors(saved.part("gaussians"), saved.facts["sky"]).to(place)
        model = AppearanceModel(settings, saved.facts["photos"]).to(place)
        model.load_state_dict(saved.part("model"))
        step, seconds = saved.facts["step"], saved.facts["trainer"]["seconds"]
        splats = gaussians.splats.detached()
    model.eval()
    return Run(folder, identity, settings, collection, step, seconds, splats, gaussians.sky, gaussians.latents, model)


def bake(trained: Run, appearance: Appearance) -> Splats:
    """The Gaussians of the run in one look, scene frame: one pass of the SH transfer; appearance is over after it."""
    return trained.model.bake(trained.splats, appearance.embedding, trained.latents)


def blend(first: Appearance, last: Appearance, share: float) -> Appearance:
    """The look `share` of the way from one to the other; at 0 and 1 the ends themselves, so that bakes are equal."""
    if share in (0.0, 1.0):
        return last if share else first
    name = f"{share:.3f} of the way from {first.name} to {last.name}"
    return Appearance(name, name, interpolate(first.embedding, last.embedding, share))


@torch.no_grad()
def find_appearance(trained: Run, word: str, mask: Path | None = None) -> Appearance:
    """The look that `word` stands for.

    mask: a picture that is white where the photo is to be used; what it hides does not enter the look at all.

    Tried in this order: `neutral`; a look saved in the run (its name, or the path of its .json); the path of a photo,
    which may be one of the collection, or the file that structure from motion made it of; the name of a photo of the
    collection. A photo of the collection is encoded with its predicted mask, any other with M := 1. Raises BadInput naming what is
    near, if nothing fits, and for the mask of a look that comes from no photo.
    """
    path = Path(word)
    kept = path if path.name != word else trained.folder / saved_look.FOLDER / f"{word.removesuffix('.json')}.json"
    is_kept = path.suffix == ".json" or (kept.is_file() and not path.is_file())
    reads_photos = trained.settings.appearance != "off" and trained.settings.embedding == "encoder"
    if mask is not None and (word == NEUTRAL or is_kept or not reads_photos):
        raise BadInput(f"The look {word} is not read from a photo that {mask} could hide a part of.", "Leave --mask out.")
    if word == NEUTRAL:
        return Appearance(NEUTRAL, "the mean of the training photos", trained.model.mean_embedding)
    if is_kept:
        look = saved_look.load(path if path.is_file() else kept, trained.identity, trained.settings.embedding_size)
        return Appearance(look.name, look.source, look.embedding.to(trained.device))
    photos = {photo.name: photo for photo in trained.collection.photos}
    if path.is_file():
        photo = next((photo for photo in photos.values() if _same_file(photo.path, path)), None)
        photo = photo or photos.get(sfm.name_in(trained.collection.root, path))
        return _of_outside(trained, path, mask) if photo is None else _of_photo(trained, photo, mask)
    if word in photos:
        return _of_photo(trained, photos[word], mask)
    if not word.strip():
        raise BadInput("The look has no name.", f"Give a photo, or {NEUTRAL}.")
    if path.is_dir():
        raise BadInput(f"{word} is a folder, not a photo.", "Give one of its photos.")
    names = {name.lower(): name for name in (*photos, *saved_look.names(trained.folder))}
    near = [names[name] for name in difflib.get_close_matches(word.lower(), names, n=1, cutoff=0.0)] or [NEUTRAL]
    raise BadInput(
        f"{word} is neither a photo file, nor a photo or saved look of {trained.folder}.",
        f"Give a path, a name such as {near[0]}, or {NEUTRAL}.",
    )


def _of_photo(trained: Run, photo: Photo, mask: Path | None) -> Appearance:
    names = trained.model.photo_names
    row = names.index(photo.name) if photo.name in names else None
    if row is None:
        _refuse_unknown_to_table(trained, photo.name)
    if mask is not None:
        photo = replace(photo, mask=mask)
    look = trained.model.look(trained.picture(photo).encoder_input, row)
    kind = "training" if row is not None else "held-out"
    return Appearance(Path(photo.name).stem, f"{kind} photo {photo.name}", look.embedding)


def _of_outside(trained: Run, path: Path, mask: Path | None) -> Appearance:
    _refuse_unknown_to_table(trained, str(path))
    pixels = files.read_light(path, mask)
    height, width = pixels.shape[:2]
    if min(height, width) < SMALLEST_PHOTO_PX:
        raise BadInput(f"{path} is {width} x {height} px, too small to show a look.", "Use a larger photo.")
    picture = shrink(torch.from_numpy(pixels).permute(2, 0, 1).float() / 255, trained.settings.encoder_side_px)
    picture = picture.to(trained.device)
    return Appearance(
        path.stem, f"photo {path.name} from outside the collection", trained.model.look(picture, masked=False).embedding
    )


def _refuse_unknown_to_table(trained: Run, name: str) -> None:
    if trained.settings.embedding == "glo" and trained.settings.appearance != "off":
        raise BadInput(
            f"{name} is not a training photo, and a run with embedding=glo knows no other looks.",
            "Name a training photo, or train with embedding=encoder.",
        )


def _same_file(first: Path, second: Path) -> bool:
    return first.is_file() and first.samefile(second)
