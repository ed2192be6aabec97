"""What is done with a run on a GPU, by the kernels of a GPU and on a device that is not the CPU,
is what a CPU does with it."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

import core.rasterizer
from core.appearance.colouring import Colouring
from core.appearance.refinement import last, refinement_steps
from core.looks.outside import read_from_outside
from core.looks.pruning import pruner_of
from core.looks.trained import TrainedRun, bake, load_run, neutral_look
from core.rasterizer.importance import largest_contributions, shares_of_picture
from core.report import QUIET
from core.run.sized_photo import as_tensors
from core.system import device
from core.training.gaussians.passers_by import passers_by
from tests.elsewhere import DEVICE, Elsewhere, elsewhere, kernels
from tests.small import finished, small_collection, small_settings

pytest.importorskip("triton", reason="Triton is not installed")
pytestmark = [
    pytest.mark.skipif(torch.cuda.is_available(), reason="the kernels are not interpreted where there is a GPU"),
    pytest.mark.filterwarnings("ignore:for .* copying from a non-meta parameter"),  # tests.elsewhere copies the numbers
]


def made_of(trained: TrainedRun) -> dict[str, Tensor]:
    """Tensors of all that a run is used for, every third of its Gaussians made as faint as to be pruned."""
    faint = torch.arange(len(trained.splats), device=trained.device) % 3 == 0
    trained = replace(
        trained,
        splats=replace(trained.splats, logit_opacities=torch.where(faint, -9.0, trained.splats.logit_opacities)),
    )
    photos = trained.collection.split("train")
    sized = trained.sized_photo(photos[0])
    look = Colouring(trained.embed(sized.encoder_input))
    pixels, valid = as_tensors(sized.pixels, sized.valid, trained.device)
    refined = last(refinement_steps(trained.seen_by, look, sized.camera, pixels, valid))
    with torch.no_grad():
        picture = trained.seen_by(sized.camera).render(refined)
    cameras = [trained.camera(photo) for photo in photos]
    pruner = pruner_of(trained, QUIET)
    mask = torch.ones(1, 3, 4, device=trained.device)
    mask[..., :2] = 0
    dark = read_from_outside(trained, torch.zeros(3, 30, 40, device=trained.device))
    return {
        "refined": refined.embedding,
        "tone": refined.tone,
        "picture": picture,
        "strongest": largest_contributions(trained.splats, cameras, trained.rasterizer),
        "kept": pruner.kept,
        "pruned": pruner(bake(trained, replace(neutral_look(trained), colouring=refined))).splats.sh,
        "shares": shares_of_picture(trained.splats, cameras[0], trained.rasterizer, pixels[..., 0] < 0.5),
        "passers-by": passers_by(trained.splats, [(cameras[0], mask)], trained.rasterizer),
        "dark": dark.tone,
    }


@pytest.fixture
def folder(tmp_path):
    """Of a run on pictures of one tile, which Triton's interpreter draws in a moment."""
    settings = small_settings(
        steps=1, max_gaussians=40, sky_gaussians=12, resolution=4, densify_rounds=0, mask_start=0.0, mask_apply=0.0
    )
    return finished(small_collection(tmp_path), settings, tmp_path).folder


def test_a_run_is_used_as_on_a_cpu(folder, monkeypatch):
    from core.appearance import positional_encoding_cuda
    from core.rasterizer.cuda.backend import CudaRasterizer

    monkeypatch.setattr("core.appearance.refinement.STEPS", 3)
    monkeypatch.setattr("core.appearance.refinement.LATER_STEPS", 2)
    expected = made_of(load_run(folder))
    assert not expected["kept"].all() and expected["passers-by"].any()
    rasterizer = CudaRasterizer()
    rasterizer.device = DEVICE.type
    monkeypatch.setattr(core.rasterizer, "create", lambda *_: rasterizer)
    monkeypatch.setattr(device, "of_run", lambda *_: DEVICE)
    monkeypatch.setattr("core.appearance.transfer_mlp.encoded_positions", positional_encoding_cuda.encoded_positions)
    torch.set_num_threads(1)  # what `elsewhere` does is for one thread
    with elsewhere(), kernels():
        made = made_of(load_run(folder))
    for name, tensor in made.items():
        assert isinstance(tensor, Elsewhere)
        torch.testing.assert_close(tensor.kept.float(), expected[name].float(), atol=1e-4, rtol=1e-3, msg=name)
