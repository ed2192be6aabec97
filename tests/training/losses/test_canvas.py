"""A photo is compared on a larger canvas as it is without one."""

import pytest
import torch

from core.training.losses.canvas import TargetOnCanvas
from core.training.losses.photometric import Target, plain_photometric

pytest.importorskip("triton", reason="Triton is not installed")

from core.training.losses.photometric_cuda import photometric_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
HEIGHT, WIDTH, CELLS = 21, 34, (7, 9)


def random(*shape: int) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(sum(shape))).to(DEVICE)


def both(valid: torch.Tensor | None, beyond: tuple[int, int]) -> tuple[Target, TargetOnCanvas]:
    photo = random(HEIGHT, WIDTH, 3)
    return Target(photo, valid), TargetOnCanvas(photo, valid, (HEIGHT + beyond[0], WIDTH + beyond[1]), CELLS)


@pytest.mark.parametrize("beyond", [(0, 0), (0, 15), (13, 0), (6, 40)])
@pytest.mark.parametrize("loss", [photometric_cuda, plain_photometric])
@pytest.mark.parametrize("partly", [False, True], ids=["all-valid", "partly-valid"])
def test_loss_and_gradient_are_those_of_the_photo_alone(beyond, loss, partly):
    valid = random(HEIGHT, WIDTH) > 0.2 if partly else None
    alone, on_canvas = both(valid, beyond)
    image = random(HEIGHT + beyond[0], WIDTH + beyond[1], 3)  # whatever is drawn beyond the photo
    weight = random(*image.shape[:2])
    found = []
    for target, height, width in ((alone, HEIGHT, WIDTH), (on_canvas, *image.shape[:2])):
        leaf = image[:height, :width].clone().requires_grad_()
        value = loss(
            leaf,
            target.brightened(torch.tensor([1.1, 0.9, 1.3], device=DEVICE)),
            weight[:height, :width].contiguous(),
            0.2,
        )
        value.backward()
        found.append((value.detach(), leaf.grad[:HEIGHT, :WIDTH]))
        assert not leaf.grad[HEIGHT:].any() and not leaf.grad[:, WIDTH:].any()
    torch.testing.assert_close(found[1], found[0], rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("beyond", [(0, 0), (6, 40)])
def test_cells_and_pixels_are_those_of_the_photo_alone(beyond):
    alone, on_canvas = both(None, beyond)
    planes, mask = random(3, HEIGHT + beyond[0], WIDTH + beyond[1]), random(1, *CELLS)
    torch.testing.assert_close(on_canvas.to_cells(planes, *CELLS), alone.to_cells(planes[:, :HEIGHT, :WIDTH], *CELLS))
    torch.testing.assert_close(on_canvas.to_pixels(mask)[:HEIGHT, :WIDTH], alone.to_pixels(mask))


def test_all_photos_on_a_canvas_have_tensors_of_the_same_sizes():
    first, second = both(None, (6, 40))[1], TargetOnCanvas(random(27, 50, 3), None, (HEIGHT + 6, WIDTH + 40), CELLS)
    assert [each.shape for each in first.tensors] == [each.shape for each in second.tensors]
