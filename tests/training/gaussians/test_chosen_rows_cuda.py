"""The GPU's way to chosen rows against torch's; by Triton's interpreter where there is no GPU."""

import pytest
import torch

from core.training.gaussians.chosen_rows import chosen_rows

pytest.importorskip("triton", reason="Triton is not installed")

from core.training.gaussians import chosen_rows_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
SHAPES = {"means": (3,), "quaternions": (4,), "logit_opacities": (), "sh": (9, 3), "latents": (16,), "none": (0,)}


@pytest.mark.parametrize(
    "count", [0, 1, 150, 256], ids=lambda count: f"{count}-rows"
)  # 256 opacities are a part of a program's, of SH seven programs'
def test_the_rows_are_those_that_torch_chooses(count):
    generator = torch.Generator().manual_seed(0)
    tensors = {name: torch.randn(300, *shape, generator=generator) for name, shape in SHAPES.items()}
    rows = torch.randperm(300, generator=generator)[:count].sort().values
    found = chosen_rows_cuda.chosen_rows({name: tensor.to(DEVICE) for name, tensor in tensors.items()}, rows.to(DEVICE))
    for name, expected in chosen_rows(tensors, rows).items():
        assert torch.equal(found[name].cpu(), expected) and torch.equal(expected, tensors[name][rows]), name


def test_copies_are_leaves_of_their_own():
    tensors = {"means": torch.randn(5, 3, device=DEVICE, requires_grad=True)}
    for choose in (chosen_rows, chosen_rows_cuda.chosen_rows):
        copy = choose(tensors, torch.tensor([0, 3], device=DEVICE))["means"]
        assert copy.is_leaf and not copy.requires_grad


@pytest.mark.parametrize(
    "tensor", [torch.arange(10.0).view(2, 5).T, torch.arange(10, dtype=torch.int32), torch.arange(10).double()]
)
def test_tensors_that_the_kernel_cannot_copy_are_copied_by_torch(tensor):
    copies = chosen_rows(
        {"other": tensor.to(DEVICE), "usual": torch.arange(10.0, device=DEVICE)}, torch.tensor([1, 4], device=DEVICE)
    )
    assert torch.equal(copies["other"].cpu(), tensor[[1, 4]]) and copies["usual"].tolist() == [1, 4]
