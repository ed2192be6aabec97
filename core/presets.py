"""What each preset changes of the settings. The command line beats the preset, which beats the defaults.

Imports no torch, like core.config.
"""

from typing import Any

from core.automatic import WITHOUT_LOOKS
from core.config import Settings
from core.errors import BadSetting

PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "quick": {"steps": 1200, "max_gaussians": 20_000},
    "paper": {
        "steps": 150_000,
        "max_gaussians": 3_000_000,
        "appearance": "full",
        "transients": "on",
        "sh_degree": 3,
        "sky": "none",
        "embedding_enters": "input",
        "embedding_size": 16,
        "latent_size": 0,
        "transfer_layers": 4,
        "transfer_width": 128,
        "encoder_side_px": 256,
        "mask_loss": "paper",
        "mask_regularisation": 0.15,  # with the paper's 1e-5 every mask hides everything within a hundred steps
        "mask_start": 0.0,
        "mask_apply": 0.0,
        "geometry_from": 0.0,
        "densify_from": WITHOUT_LOOKS["densify_from"],
        "sh_regularisation": 0.1,
        "exposure_jitter": 0.0,
        "colour_bands": 0,
        "reach": 0.0,
        "largest_scale": 1.0,
        "prune_contribution": 0.0,
        "remove_veils": False,
        "remove_passers_by": False,
        "gauge": 0.0,
    },
    "vanilla": {"appearance": "off", "transients": "off"},
}


def preset(name: str) -> Settings:
    """The settings of a preset, a key of PRESETS."""
    if name not in PRESETS:
        raise BadSetting(f"There is no preset {name!r}.", f"Choose one of: {', '.join(PRESETS)}.", ("preset",))
    return Settings().changed(**PRESETS[name])
