"""The GPU's picture loss equals its definition; by Triton's interpreter where there is no GPU."""

import pytest
import torch

from core.errors import BadInput
from core.training.losses.photometric import Target, plain_photometric
from tests.training.losses.test_photometric import ERROR_TOLERANCE, GRADIENT_TOLERANCE, example, run

pytest.importorskip("triton", reason="Triton is not installed")

from core.training.losses.photometric_cuda import photometric_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@pytest.mark.parametrize("size", [(1, 1), (15, 19)], ids=str)  # the latter takes three programs
@pytest.mark.parametrize("masked", [False, True], ids=["whole", "weighted-with-invalid-pixels"])
def test_the_kernels_equal_the_definition(size, masked):
    image, photo, weight, valid = example(*size, masked=masked)
    if masked:
        image[~valid] = torch.nan
    weight = weight if masked else None
    given = [None if part is None else part.to(DEVICE) for part in (image, photo, weight, valid)]
    loss, gradient = (
        part.cpu().double() for part in run(photometric_cuda, given[0], Target(given[1], given[3]), given[2])
    )
    double = None if weight is None else weight.double()
    true = run(plain_photometric, image.double(), Target(photo.double(), valid), double)
    torch.testing.assert_close(loss, true[0], rtol=0, atol=ERROR_TOLERANCE)
    torch.testing.assert_close(gradient, true[1], rtol=0, atol=GRADIENT_TOLERANCE * float(true[1].abs().max()))


@pytest.mark.parametrize("ssim_weight", [0.0, 1.0])
def test_the_kernels_equal_the_definition_with_either_term_alone(ssim_weight):
    image, photo, _, _ = example(12, 13)
    target = Target(photo.to(DEVICE))
    ours = [part.cpu().double() for part in run(photometric_cuda, image.to(DEVICE), target, None, ssim_weight)]
    true = run(plain_photometric, image.double(), Target(photo.double()), None, ssim_weight)
    torch.testing.assert_close(ours[0], true[0], rtol=0, atol=ERROR_TOLERANCE)
    torch.testing.assert_close(ours[1], true[1], rtol=0, atol=GRADIENT_TOLERANCE * float(true[1].abs().max()))


def test_a_photo_of_which_32_bits_cannot_count_the_planes_is_refused():
    image = torch.zeros(1, 1, 3, device=DEVICE).expand(15_000, 16_000, 3)
    with pytest.raises(BadInput, match="16000x15000 px .* can count"):
        photometric_cuda(image, Target(torch.zeros(1, 1, 3, device=DEVICE)), None, 0.2)
