"""A run on the CUDA kernels is the run on the CPU's, as far as rounding lets it be."""

import pytest
import torch

from core.training.trainer import Trainer
from tests.small import small_collection, small_settings

pytest.importorskip("triton", reason="Triton is not installed")

ON_GPU = torch.cuda.is_available()
# Triton's interpreter draws a quarter of the size, one tile, in a second a step.
SIZES = {"steps": 3, "coarse_until": 1.0, "max_gaussians": 120, "sky_gaussians": 12}
SETTINGS = SIZES | {
    "mask_start": 0.0,
    "mask_apply": 0.0,
    "held_out_checks": 0,
    "densify_rounds": 0,
    "geometry_from": 0.0,
}


def losses(folder, **changes) -> list[float]:
    """The loss of each step of a small run without growth, masks and L_regTS included."""
    folder.mkdir()
    trainer = Trainer(small_collection(folder), small_settings(**SETTINGS, **changes), folder)
    return [trainer.step().loss for _ in range(SETTINGS["steps"])]


def test_losses_are_those_of_the_cpu(tmp_path):
    place = {"device": "cuda"} if ON_GPU else {"device": "cpu", "backend": "cuda"}
    ours, expected = losses(tmp_path / "cuda", **place), losses(tmp_path / "cpu", device="cpu")
    # Losses of order 0.1 over a hundred pixels of one picture, each good to 1e-6; two steps of Adam keep that.
    assert ours == pytest.approx(expected, abs=1e-5)
