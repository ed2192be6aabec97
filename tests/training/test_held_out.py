"""How good a run is while it goes: held-out photos are judged as they are shown, and only where they show something."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.scene.harmonics import dc_of_colour


def test_held_out_renders_are_judged_as_they_are_shown(trainer_of):
    """Three times as bright as white is white."""
    trainer = trainer_of(appearance="off", transients="off")
    white = [replace(sized, pixels=np.full_like(sized.pixels, 255)) for sized in trainer.held_out]
    trainer.held_out.photos[:] = white
    trainer.gaussians.parameters["sh"][:, 0] = float(dc_of_colour(torch.tensor(3.0)))
    psnr, ssim = trainer.held_out_quality()
    assert psnr > 60 and ssim > 0.999
    # What a photo does not show is not compared.
    seen = np.arange(white[0].pixels.shape[1]) >= 20
    half = [replace(sized, pixels=sized.pixels * seen[:, None].astype(np.uint8), valid=np.tile(seen, (len(sized.pixels), 1))) for sized in white]
    trainer.held_out.photos[:] = half
    assert trainer.held_out_quality() == pytest.approx((psnr, ssim), abs=1e-3)
    # Grey on white: half of the range off, and an SSIM of 0.8, or of 0.64 where the window reaches beyond the picture.
    trainer.held_out.photos[:] = white
    trainer.gaussians.parameters["sh"][:, 0] = float(dc_of_colour(torch.tensor(0.5)))
    assert trainer.held_out_quality() == pytest.approx((6.02, 0.74), abs=0.01)
