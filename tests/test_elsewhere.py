"""Every tensor of the story follows the device:
trained, kept, gone on with, baked, measured on one that is not the CPU.

See tests.elsewhere for what this can tell: that nothing is left behind, not what a GPU computes.
"""

from importlib import import_module

import cv2
import numpy as np
import pytest
import torch

import core.rasterizer
from core import pipeline
from core.bench.baking import baking_figure
from core.bench.refinement import refinement_figure
from core.evaluation import lpips
from core.evaluation.lpips import Lpips
from core.looks.trained import load_run
from core.report import QUIET
from core.system import device
from core.training import decisions
from core.training.gaussians import densify, gaussians
from core.training.gaussians.adam import plain_adam_rows
from tests.elsewhere import DEVICE, Elsewhere, MixedDevices, elsewhere
from tests.evaluation.test_lpips import made_weights
from tests.heard import Heard, StopsAtStep
from tests.rasterizer.backends import Moving
from tests.small import HEIGHT, WIDTH, small_scene, small_settings

# Not so: tests.elsewhere copies the numbers.
pytestmark = pytest.mark.filterwarnings("ignore:for .* copying from a non-meta parameter")


def fetched(tensor):
    assert isinstance(tensor, Elsewhere)
    return tensor.cpu()


@pytest.fixture(autouse=True)
def on_device(monkeypatch):
    """The settings' device is DEVICE, and so is that of a run."""
    rasterizer = Moving(core.rasterizer.create("cpu"), fetched, lambda tensor: tensor.to(DEVICE))
    monkeypatch.setattr(core.rasterizer, "create", lambda *_: rasterizer)
    monkeypatch.setattr(device, "chosen", lambda *_: DEVICE)
    monkeypatch.setattr(gaussians, "adam_rows", plain_adam_rows)  # a GPU has kernels of its own
    monkeypatch.setattr(densify, "gather", densify.plain_gather)
    monkeypatch.setattr("core.pipeline.training.compile_kernels", lambda looks: None)  # those of a CPU
    # torch's list of devices with a fused Adam has CUDA, and not this one.
    monkeypatch.setattr(import_module("torch.optim.adam"), "_device_dtype_check_for_fused", lambda *_, **__: None)
    torch.set_num_threads(1)  # what `elsewhere` does is for one thread
    with elsewhere():
        yield


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A folder of which `pipeline` reads the small collection."""
    return small_scene(tmp_path / "scene", monkeypatch)


def test_a_whole_run_leaves_no_tensor_on_the_cpu(scene, tmp_path, monkeypatch):
    """With growth, pruning, masks, L_regTS, the removal of passers-by and the checks of held-out quality."""
    monkeypatch.setattr(decisions, "FEWEST_FOR_MASKS", 0)
    settings = small_settings(steps=12, mask_start=0.0, mask_apply=0.0)
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(scene, settings, tmp_path / "run", StopsAtStep(5))
    heard = Heard()
    folder = pipeline.resume(tmp_path / "run", heard)
    assert any("held-out PSNR" in line for line in heard.lines)
    run = load_run(folder)
    assert isinstance(run.splats.sh, Elsewhere) and isinstance(run.model.mean_embedding, Elsewhere)
    monkeypatch.setattr("core.appearance.refinement.STEPS", 2)
    monkeypatch.setattr("core.appearance.refinement.LATER_STEPS", 2)
    pipeline.bake_to_file(folder, "photo_0.png", tmp_path / "look.ply", save_as="kept")
    pipeline.bake_to_file(folder, str(scene / "photo_1.png"), tmp_path / "other.ply", prune=False)
    cv2.imwrite(str(tmp_path / "night.png"), np.zeros((30, 40, 3), np.uint8))
    pipeline.bake_to_file(folder, str(tmp_path / "night.png"), tmp_path / "night.ply", heard, save_as="night")
    assert any("lit unlike any photo of the place (darker" in line for line in heard.lines)
    pipeline.interpolate(folder, "night", "kept", 3, tmp_path / "dawn")
    pipeline.interpolate(folder, "kept", "neutral", 2, tmp_path / "fade", ply=True)
    monkeypatch.setattr(lpips, "load", lambda device: Lpips(made_weights()).to(device))
    scores = pipeline.evaluate(folder, protocol="full").views[0].scores["photo"]
    assert scores["refined"].lpips > 0 and scores["refined"].psnr >= scores["zero_shot"].psnr - 0.1  # L1 is refined
    pipeline.evaluate(folder, protocol="half")
    cv2.imwrite(str(tmp_path / "mask.png"), np.tile(np.uint8([0, 255]), (HEIGHT, WIDTH // 2)))
    pipeline.bake_to_file(folder, "photo_2.png", tmp_path / "masked.ply", mask=tmp_path / "mask.png")
    monkeypatch.setattr("core.bench.baking.SHARES", (0.3,))
    assert baking_figure(run, views=1, report=QUIET, budget=0.0).points
    assert refinement_figure({"run": run}, ("half",), photos=1, report=QUIET).points


@pytest.mark.parametrize(
    "changes",
    [
        {"embedding": "glo", "mask": "mlp", "latent_size": 3, "latents_from": 0.0},
        {"mask": "cnn", "mask_loss": "paper", "embedding_enters": "input", "sh_octaves": 1, "detach_sh": True},
        {"appearance": "exposure", "channel_attention": False, "sky": "none"},
        {"appearance": "off", "transients": "off", "exposure_jitter": 0.0},
        {"residual": False},
    ],
    ids=lambda changes: "-".join(map(str, changes.values())),
)
def test_no_setting_leaves_a_tensor_on_the_cpu(scene, tmp_path, changes):
    settings = small_settings(steps=2, mask_start=0.0, mask_apply=0.0, **changes)
    pipeline.train(scene, settings, tmp_path / "run")


def test_a_tensor_left_behind_is_found():
    there = torch.zeros(3, device=DEVICE)
    assert isinstance(there, Elsewhere) and torch.equal((there + 1).cpu(), torch.ones(3))
    with pytest.raises(MixedDevices, match=r"aten.add.Tensor got \[\(3,\)\] on the CPU"):
        there + torch.ones(3)
    with pytest.raises(MixedDevices):
        there[torch.arange(2)]
    assert float(there.sum() + torch.tensor(2.0)) == 2.0  # single numbers may come from anywhere
