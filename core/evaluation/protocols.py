"""The two protocols by which methods for scenes in the wild are compared; their figures never share a table.

half (NeRF-W): the embedding comes from the left half of a test photo, W - W // 2 columns; the figures come from the
right half, which the embedding has not seen. (nerfbaselines also scores the middle column of an odd W, which the
embedding has seen.)
full (Ha-NeRF, CR-NeRF, GS-W): embedding and figures come from the whole photo.

Pictures are quantised to 8 bits before they are compared, and masks never enter a metric.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from torch import Tensor

from core.appearance.colouring import Colouring
from core.appearance.refinement import last, refinement_steps
from core.data.photos.fill import fill
from core.errors import BadInput, BadSetting
from core.evaluation import PROTOCOLS, metrics
from core.evaluation.subject import Subject
from core.evaluation.truth import UNKNOWN, Truth
from core.export.pictures import to_8_bit
from core.scene.camera import Camera

Distance = Callable[[Tensor, Tensor], float | None]  # LPIPS


@dataclass(frozen=True)
class HeldOutView:
    """A test photo. picture: [0, 1], at the size of `camera`.
    valid: where the photo shows something; None: everywhere."""

    name: str
    picture: Float[Tensor, "h w 3"]
    camera: Camera
    valid: Bool[Tensor, "h w"] | None = None
    truth: Truth = UNKNOWN


@dataclass(frozen=True)
class Fit:
    """The part of a view that gives the look, and the part that is scored.

    photo: quantised, whole. region: the columns of it that give the look, as `camera` sees them. scored: the columns
    that are scored. valid, scored_valid: as in HeldOutView, of either. start: the encoder's embedding of the region.
    """

    photo: Float[Tensor, "h w 3"]
    region: Float[Tensor, "h w_fitted 3"]
    camera: Camera
    valid: Bool[Tensor, "h w_fitted"] | None
    scored: slice
    scored_valid: Bool[Tensor, "h w_scored"] | None
    start: Float[Tensor, " e"]

    def psnr(self, image: Float[Tensor, "h w 3"]) -> float:
        """The PSNR (dB) of a render of the whole view, where it is scored."""
        columns = metrics.quantised(image)[:, self.scored]
        return metrics.psnr(columns, self.photo[:, self.scored], self.scored_valid)


def fit_of(subject: Subject, view: HeldOutView, protocol: str) -> Fit:
    """The Fit of a view by `protocol`; raises as `regions` does."""
    fitted, scored = regions(view, protocol)
    photo = metrics.quantised(view.picture)
    region = photo[:, fitted]
    camera = view.camera.cropped(0, 0, region.shape[1], region.shape[0])
    valid, scored_valid = (None if view.valid is None else view.valid[:, part] for part in (fitted, scored))
    # Transparent pixels are filled again, as their colours may come from the part that is scored.
    if valid is not None and fitted != scored:
        region = torch.from_numpy(fill(to_8_bit(region), valid.cpu().numpy())).to(region) / 255
    start = subject.embed(region.permute(2, 0, 1).contiguous())
    return Fit(photo, region, camera, valid, scored, scored_valid, start)


def refining(subject: Subject, fit: Fit) -> Iterator[Colouring]:
    """The steps of core.appearance.refinement on the region that gives the look."""
    return refinement_steps(subject.seen_by, Colouring(fit.start), fit.camera, fit.region, fit.valid)


def refined(subject: Subject, fit: Fit) -> Colouring:
    """The look of the region, refined."""
    return last(refining(subject, fit))


@dataclass(frozen=True)
class Scores:
    """psnr: dB. ssim, lpips: None where they cannot be computed (too small a picture; no weights)."""

    psnr: float
    ssim: float | None
    lpips: float | None


@dataclass(frozen=True)
class ViewResult:
    """The figures of one photo.

    scores: by what the render is compared with, then by the look it shows.
      photo: the test photo, in the scored columns. clean: all of the clean truth. clean_right: its right half.
      zero_shot: the encoder's look. refined: that look refined, if it was.
    mask_iou: overlap of predicted and true passers-by, if both are known.
    """

    name: str
    width: int
    height: int
    scores: dict[str, dict[str, Scores]]
    mask_iou: float | None


@dataclass(frozen=True)
class ViewPictures:
    """Pictures to look at. look: the one that `render` shows, a key of WAYS; None for a run with only one.
    mask: [0, 1], of any size, or None."""

    name: str
    photo: UInt8[ndarray, "h w 3"]
    render: UInt8[ndarray, "h w 3"]
    look: str | None
    mask: Float[ndarray, "h4 w4"] | None


def measure(
    subject: Subject, view: HeldOutView, protocol: str, refine: bool = True, lpips: Distance | None = None
) -> tuple[ViewResult, ViewPictures]:
    """Measure one photo by `protocol`, a key of PROTOCOLS.

    refine: score the refined look, too, beside the zero-shot one. Raises as `regions` does.
    """
    fit = fit_of(subject, view, protocol)
    photo, scored = fit.photo, fit.scored
    height, width = photo.shape[:2]
    looks = {"zero_shot": Colouring(fit.start)}
    if refine and subject.has_looks:
        looks["refined"] = refined(subject, fit)
    shown = "refined" if "refined" in looks else "zero_shot"

    everything = slice(0, width)
    against = {"photo": (photo, view.valid, scored)}
    if view.truth.clean is not None:
        against["clean"] = (metrics.quantised(view.truth.clean), None, everything)
        if protocol == "half":
            against["clean_right"] = (against["clean"][0], None, scored)
    seen = subject.seen_by(view.camera)
    with torch.no_grad():
        images = {look: metrics.quantised(seen.render(colouring)) for look, colouring in looks.items()}
    scores = {}
    for name, (truth, valid, columns) in against.items():
        part = None if valid is None else valid[:, columns]
        scores[name] = {
            look: compare(image[:, columns], truth[:, columns], part, lpips) for look, image in images.items()
        }
    mask = subject.mask(photo.permute(2, 0, 1).contiguous())
    overlap = None if mask is None or view.truth.static is None else metrics.mask_iou(mask, view.truth.static)
    drawn_mask = None if mask is None else mask.cpu().numpy()
    pictures = ViewPictures(
        view.name, to_8_bit(photo), to_8_bit(images[shown]), shown if subject.has_looks else None, drawn_mask
    )
    return ViewResult(view.name, width, height, scores, overlap), pictures


def check_protocol(protocol: str) -> None:
    """Raise BadSetting unless it is a key of PROTOCOLS."""
    if protocol not in PROTOCOLS:
        raise BadSetting(f"There is no protocol {protocol!r}.", f"Choose one of: {', '.join(PROTOCOLS)}.")


def regions(view: HeldOutView, protocol: str) -> tuple[slice, slice]:
    """The columns of the photo that give the look, and those that are scored.

    Raises BadSetting for an unknown protocol, and BadInput for a photo that is too narrow to be halved or has no valid
    pixel in one of them.
    """
    check_protocol(protocol)
    width = view.picture.shape[1]
    fitted = scored = slice(0, width)
    if protocol == "half":
        fitted, scored = slice(0, width - width // 2), slice(width - width // 2, width)
        if fitted.stop == width:
            raise BadInput(f"{view.name} is {width} px wide and has no halves.", "Type: wegs eval --protocol full")
    for columns, part in ((fitted, "that gives the look"), (scored, "that is scored")):
        if view.valid is not None and not view.valid[:, columns].any():
            raise BadInput(f"{view.name} has no valid pixel in the part {part}.", "Take it out of the test photos.")
    return fitted, scored


def compare(
    image: Float[Tensor, "h w 3"],
    photo: Float[Tensor, "h w 3"],
    valid: Bool[Tensor, "h w"] | None = None,
    lpips: Distance | None = None,
) -> Scores:
    """All metrics of two quantised pictures. LPIPS needs whole pictures,
    so invalid pixels are taken from the photo in both."""
    shown = image if valid is None else torch.where(valid[..., None], image, photo)
    distance = None if lpips is None else lpips(shown, photo)
    return Scores(metrics.psnr(image, photo, valid), metrics.ssim(image, photo, valid), distance)
