"""Every setting once: type, default, unit, range and help. Options, presets and saved files are made from this page.

Imports no torch, so that `wegs --help` answers at once.
"""

import difflib
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from core.automatic import (
    AUTO_PIXELS,
    GAUSSIANS_PER_PHOTO,
    LEAST,
    PIXELS_PER_GAUSSIAN,
    SCALE_RATES,
    SCALE_TRAVEL,
    STEPS_FOR_FEW,
    STEPS_PER_PHOTO,
    STEPS_PER_PHOTO_OF_MANY,
    WITH_LOOKS,
    WITHOUT_LOOKS,
    scale_rate_for,
)
from core.errors import BadSetting
from core.setting import AUTO, UNDECIDED, checked, setting


@dataclass(frozen=True)
class Settings:
    """All that decides how a run turns out. Fractions are of `steps`; lengths are scene units (scene radius 1)."""

    steps: int = setting(
        UNDECIDED,
        "Training steps; every schedule is a fraction of them. "
        f"auto: {STEPS_PER_PHOTO} per training photo, at least {LEAST['steps']:,} and at most "
        f"{STEPS_FOR_FEW:,}; {STEPS_PER_PHOTO_OF_MANY} per photo where that is more.",
        low=1,
        auto=True,
        section="The run",
    )
    seed: int = setting(0, "Random seed.", low=0, high=2**63 - 1)
    device: str = setting(
        "auto", "Where to compute. auto: an NVIDIA GPU if torch finds one.", choices=("auto", "cpu", "cuda")
    )
    backend: str = setting(
        "auto",
        "Rasterizer. auto: the device's own. reference: slow, for tests.",
        choices=("auto", "reference", "cpu", "cuda"),
    )
    resolution: int = setting(
        UNDECIDED,
        "Size of the photos in training. 1, 2, 4 or 8: divided by that; larger numbers: a width in px. auto: large "
        f"ones shrunk, to a mean of {AUTO_PIXELS['cpu']:,} pixels on a CPU, {AUTO_PIXELS['cuda']:,} on a GPU.",
        low=1,
        auto=True,
    )
    all_photos: bool = setting(
        False, "Train on the held-out photos, too: a better scene, but nothing is left to measure it on."
    )
    max_gaussians: int = setting(
        UNDECIDED,
        "Upper limit on the number of Gaussians, not counting the sky. "
        f"auto: one per {PIXELS_PER_GAUSSIAN} pixels of all training "
        f"photos together, or {GAUSSIANS_PER_PHOTO} per photo if that is more; at least {LEAST['max_gaussians']:,}.",
        low=1,
        auto=True,
    )
    sh_degree: int = setting(
        UNDECIDED,
        "Degree of the spherical harmonics, 0 to 3. "
        "auto: 0 or 1, by whether colours in the photos depend on the viewing direction.",
        low=0,
        high=3,
        auto=True,
    )

    appearance: str = setting(
        AUTO,
        "How looks may differ between photos: off = not at all, exposure = by an affine colour map, "
        "full = by SH transfer. auto: the photos decide.",
        choices=(AUTO, "off", "exposure", "full"),
        section="Parts of the method",
    )
    transients: str = setting(
        AUTO, "Whether passers-by (transients) are masked. auto: the photos decide.", choices=(AUTO, "off", "on")
    )
    sky: str = setting(
        AUTO,
        "What stands behind everything: a far dome of Gaussians, or nothing. "
        "auto: nothing where transparent pixels are empty.",
        choices=(AUTO, "none", "dome"),
    )
    transparency: str = setting(
        AUTO,
        "What transparent pixels mean: unseen = nobody saw what is there, empty = nothing is. "
        "auto: empty in a Blender scene without a dome.",
        choices=(AUTO, "unseen", "empty"),
    )
    embedding: str = setting(
        "encoder", "Where a photo's embedding comes from: the encoder, or a table (GLO).", choices=("encoder", "glo")
    )
    mask: str = setting(
        "attention",
        "What predicts the mask: the encoder's attention, a separate CNN, an MLP over (photo, u, v).",
        choices=("attention", "cnn", "mlp"),
    )
    colour_bands: int = setting(
        4,
        "Horizontal bands of a photo whose mean colours enter its embedding, beside its features; 0: none (paper).",
        low=0,
        high=64,
    )
    channel_attention: bool = setting(True, "Channel attention (CAM) in the encoder.")
    residual: bool = setting(True, "The SH transfer predicts a residual, not the coefficients themselves.")
    detach_sh: bool = setting(False, "Stop the gradient into the base SH through the SH transfer.")
    exposure_jitter: float = setting(
        0.15, "Spread (log) of the random exposure and white balance a photo gets in training.", low=0, high=1
    )

    # The sizes that a look has were chosen by the table in core/TRIED.md, "Capacity of a look".
    embedding_size: int = setting(32, "Numbers in a photo's embedding.", low=1, high=1024, section="Sizes")
    latent_size: int = setting(
        16,
        "Learned numbers per Gaussian for the SH transfer, on top of SH and position; 0: none (paper).",
        low=0,
        high=1024,
    )
    embedding_enters: str = setting(
        "output",
        "Where the embedding enters the SH transfer: as weights of its output layer, or as an input (paper).",
        choices=("output", "input"),
    )
    transfer_layers: int = setting(3, "Layers of the SH transfer MLP.", low=2, high=64)
    transfer_width: int = setting(64, "Width of the SH transfer MLP.", low=1, high=4096)
    position_octaves: int = setting(4, "Octaves of the positional encoding of centres.", low=0, high=16)
    sh_octaves: int = setting(
        0,
        "Octaves of the positional encoding of base SH. "
        "From sh_degree 2 on they need embedding_enters=input, or training falls apart.",
        low=0,
        high=16,
    )
    residual_bound: float = setting(4.0, "Largest residual of an SH coefficient.", low=0.1, high=1_000_000)
    encoder_side_px: int = setting(
        144, "Photos are squeezed to a square of this side before the encoder, never enlarged.", low=16, high=4096
    )
    sky_gaussians: int = setting(1500, "Gaussians of the sky's dome.", low=12, high=20_000)
    sky_radius: float = setting(
        30.0,
        "Least radius of the sky's dome; it grows to enclose all cameras but those far astray.",
        low=2,
        high=20_000,
    )

    ssim_weight: float = setting(
        0.2, "Share of 1 - SSIM in the picture loss; the rest is L1.", low=0, high=1, section="Losses"
    )
    mask_loss: str = setting(
        "weighted",
        "How masks enter the picture loss: weighting the maps, or multiplying the pictures, "
        "whose error then teaches them (paper).",
        choices=("weighted", "paper"),
    )
    mask_regularisation: float = setting(
        0.00625,
        "Weight of mean((1 - M)^2) (L_regM); mask_loss=paper takes more, such as 0.15, or masks hide everything.",
        low=0,
        high=1_000_000,
    )
    sh_regularisation: float = setting(0.001, "Weight of the mean residual norm (L_regSH).", low=0, high=1_000_000)
    transient_regularisation: float = setting(
        1e-5, "Weight of the summed opacity of Gaussians seen where M < 0.5 (L_regTS).", low=0, high=1_000_000
    )
    gauge: float = setting(0.01, "Weight that holds the residual of the mean embedding at zero.", low=0, high=1_000_000)

    mean_rate: float = setting(
        8e-4,
        "Learning rate of centres, decaying to a hundredth; scene units per step.",
        low=0,
        high=1,
        section="Learning rates (Adam)",
    )
    quaternion_rate: float = setting(2e-3, "Learning rate of quaternions.", low=0, high=1)
    scale_rate: float = setting(
        UNDECIDED,
        f"Learning rate of log scales. auto: {SCALE_TRAVEL:g} / steps, between {SCALE_RATES[0]} and {SCALE_RATES[1]}.",
        low=0,
        high=1,
        auto=True,
    )
    opacity_rate: float = setting(4e-2, "Learning rate of logit opacities.", low=0, high=1)
    sh_rate: float = setting(5e-3, "Learning rate of DC coefficients; the other bands get a twentieth.", low=0, high=1)
    network_rate: float = setting(
        4e-3, "Learning rate of the SH transfer and the mask, decaying to a tenth.", low=0, high=1
    )
    encoder_rate: float = setting(5e-4, "Learning rate of the encoder, decaying to a tenth.", low=0, high=1)
    embedding_rate: float = setting(
        1e-2, "Learning rate of GLO embeddings and latents, decaying to a tenth.", low=0, high=1
    )

    densify_from: float = setting(
        UNDECIDED,
        "Fraction at which growth starts. auto: "
        f"{WITH_LOOKS['densify_from']}, or {WITHOUT_LOOKS['densify_from']:g} without looks.",
        low=0,
        high=1,
        auto=True,
        section="Density control",
    )
    densify_until: float = setting(0.6, "Fraction at which growth ends.", low=0, high=1)
    densify_rounds: int = setting(30, "Rounds of growth in between.", low=0, high=1_000_000)
    largest_scale: float = setting(0.15, "Gaussians larger than this are removed, scene units.", low=0.001)
    reach: float = setting(
        4.0,
        "Gaussians farther from SfM points than this many times the points' spacing there (at least the median) "
        "are removed; 0 keeps all.",
        low=0,
    )
    prune_opacity: float = setting(0.01, "Gaussians fainter than this are removed.", low=0, high=1)
    prune_contribution: float = setting(
        UNDECIDED,
        "Gaussians are removed that make up this share of no pixel in any photo: after growth, and during a long one. "
        f"auto: {WITH_LOOKS['prune_contribution']}, or {WITHOUT_LOOKS['prune_contribution']:g} without looks.",
        low=0,
        high=1,
        auto=True,
    )
    remove_veils: bool = setting(
        True,
        "After growth, remove Gaussians that hardly cover any photo but much of what a camera beside it would see.",
    )
    remove_passers_by: bool = setting(
        True,
        "After growth, remove Gaussians that masks hide in one or two photos, if photos are enough to learn masks.",
    )

    coarse_until: float = setting(
        0.2,
        "Fraction of the steps on shrunken photos, at first a quarter of the size.",
        low=0,
        high=1,
        section="Schedule",
    )
    geometry_from: float = setting(
        UNDECIDED,
        "Fraction at which the geometry begins to move; until then only looks are learned. "
        f"auto: {WITH_LOOKS['geometry_from']}, or {WITHOUT_LOOKS['geometry_from']:g} without looks.",
        low=0,
        high=1,
        auto=True,
    )
    mask_start: float = setting(0.2, "Fraction at which the mask begins to learn.", low=0, high=1)
    mask_apply: float = setting(0.6, "Fraction from which the mask weights the picture loss.", low=0, high=1)
    latents_from: float = setting(
        0.6,
        "Fraction at which latents begin to learn; sooner they would learn passers-by, whom the mask hides by then.",
        low=0,
        high=1,
    )
    held_out_checks: int = setting(4, "Times held-out quality is measured on the way.", low=0, high=1_000_000)
    checkpoints: int = setting(4, "Checkpoints written on the way.", low=1, high=1_000_000)

    def __post_init__(self):
        for name, item in FIELDS.items():
            object.__setattr__(self, name, checked(item, getattr(self, name)))
        if self.transparency == "empty" and self.sky == "dome":
            what = "transparency=empty with sky=dome: a dome leaves nothing empty."
            raise BadSetting(what, "Leave one of them out.", ("transparency", "sky"))
        if self.densify_from > self.densify_until:
            what = f"densify_from={self.densify_from} is after densify_until={self.densify_until}."
            raise BadSetting(what, "Growth must start first.", ("densify_from", "densify_until"))
        if self.mask_start > self.mask_apply:
            what = f"mask_start={self.mask_start} is after mask_apply={self.mask_apply}."
            raise BadSetting(what, "A mask must learn before it hides.", ("mask_start", "mask_apply"))

    def changed(self, **values: Any) -> "Settings":
        """A copy with other values; unknown names and values out of range raise BadSetting."""
        for name in values:
            if name not in FIELDS:
                raise no_setting(name)
        return replace(self, **values)

    def decided(self, **answers: Any) -> "Settings":
        """A copy in which what was left to be decided has these values.

        Once the appearance is known, so is what follows from it and from the number of steps.
        """
        settings = self.changed(**{name: answers[name] for name in self.undecided if name in answers})
        if settings.appearance == AUTO:
            return settings
        follows = dict(WITH_LOOKS if settings.has_looks else WITHOUT_LOOKS)
        follows["densify_from"] = min(follows["densify_from"], settings.densify_until)
        if settings.steps != UNDECIDED:
            follows["scale_rate"] = scale_rate_for(settings.steps)
        return settings.changed(**{name: follows[name] for name in settings.undecided if name in follows})

    @property
    def undecided(self) -> tuple[str, ...]:
        """The settings that the data have yet to decide."""
        return tuple(name for name in DECIDABLE if getattr(self, name) in (AUTO, UNDECIDED))

    @property
    def has_looks(self) -> bool:
        """Whether photos differ in their looks; this and what follows is known once it is decided."""
        return self.appearance != "off"

    @property
    def encodes_photos(self) -> bool:
        """Whether a look is what the encoder reads from a photo."""
        return self.has_looks and self.embedding == "encoder"

    @property
    def has_masks(self) -> bool:
        """Whether masks of passers-by are learned."""
        return self.transients == "on"

    @property
    def transparent_is_empty(self) -> bool:
        """Whether transparent pixels are learned and scored as empty space, once that is decided."""
        return self.transparency == "empty"

    def to_json(self) -> dict:
        """The settings by name, which `changed` takes again."""
        return asdict(self)


FIELDS = {item.name: item for item in fields(Settings)}


def no_setting(name: str) -> BadSetting:
    """The error for a name that no setting has."""
    begin_so = [known for known in FIELDS if name and known.startswith(name.lower())]
    near = difflib.get_close_matches(name.lower(), FIELDS, n=1) or begin_so
    fix = f"Did you mean {', '.join(near)}?" if near else "`wegs train --help` lists them."
    return BadSetting(f"There is no setting {name!r}.", fix, (name,))


DECIDABLE = (  # what may be left to the data
    *("appearance", "transients", "sh_degree", "sky", "transparency"),
    *("steps", "max_gaussians", "scale_rate", "geometry_from", "densify_from", "prune_contribution"),
)
