"""The quality of a run in progress: renders of held-out photos are judged as they are displayed,
and only where the photo shows something."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core.run import checkpoint
from core.scene.harmonics import dc_of_colour
from core.training.trainer import Trainer
from tests.small import HEIGHT, WIDTH, small_collection, small_settings
from tests.training.learned import assert_same


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
    half = [
        replace(
            sized, pixels=sized.pixels * seen[:, None].astype(np.uint8), valid=np.tile(seen, (len(sized.pixels), 1))
        )
        for sized in white
    ]
    trainer.held_out.photos[:] = half
    assert trainer.held_out_quality() == pytest.approx((psnr, ssim), abs=1e-3)
    # Grey on white: half of the range off, and an SSIM of 0.8, or of 0.64 where the window reaches beyond the picture.
    trainer.held_out.photos[:] = white
    trainer.gaussians.parameters["sh"][:, 0] = float(dc_of_colour(torch.tensor(0.5)))
    assert trainer.held_out_quality() == pytest.approx((6.02, 0.74), abs=0.01)


def test_what_held_out_photos_show_teaches_nothing(tmp_path):
    """Of two scenes that differ in their held-out photos alone, every tensor of a whole run is the same, bit for bit:
    decisions, growth, sky and all."""
    checkpoints, judged = [], []
    for name in ("as they are", "of noise"):
        folder = tmp_path / name
        folder.mkdir()
        collection = small_collection(folder)
        if name == "of noise":
            for photo in collection.split("test"):
                cv2.imwrite(str(photo.path), np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8))
        settings = small_settings(prune_contribution=0.05).changed(
            appearance="auto", transients="auto", sh_degree="auto"
        )
        trainer = Trainer.of_new_run(collection, settings, folder / "run")
        judged.append([report.held_out_psnr for report in trainer.train()])
        checkpoints.append(checkpoint.load(checkpoint.newest(folder / "run")).tensors)
    assert judged[0] != judged[1]
    assert_same(*checkpoints)
