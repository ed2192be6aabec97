"""The fused picture loss equals its definition, and the definition is right."""

import re

import numba
import pytest
import torch

from core.errors import BadInput
from core.training.losses import photometric_cpu
from core.training.losses.photometric import (
    Target,
    blur,
    photometric,
    photometric_of_mask,
    photometric_paper,
    plain_photometric,
)
from tests.afresh import assembly_of

# float32 keeps 1e-7 of values near 1; SSIM subtracts squares of them and divides by at least C2 = 9e-4.
ERROR_TOLERANCE = 2e-5
# Relative to the largest entry of the gradient; the same cancellation, and a sum of 3 x 121 products behind each entry.
GRADIENT_TOLERANCE = 5e-5

SIZES = [(1, 1), (1, 7), (9, 1), (15, 17), (33, 16), (301, 270)]  # the last takes two blocks


@pytest.fixture(autouse=True)
def one_thread(same_conditions):
    """The definition's small convolutions take ten times as long on threads that wait for each other."""
    torch.set_num_threads(1)


def example(height, width, *, masked=False, seed=0):
    """image, photo, weight, valid in float32; the image leaves [0, 1], as renders do, and is the photo at the top."""
    generator = torch.Generator().manual_seed(seed)
    photo = torch.rand(height, width, 3, generator=generator)
    image = photo + 0.3 * torch.randn(height, width, 3, generator=generator)
    image[: height // 4] = photo[: height // 4]
    weight = torch.rand(height, width, generator=generator)
    weight[:, : width // 3] = 0
    valid = torch.rand(height, width, generator=generator) < 0.8 if masked else None
    if masked:
        valid[0, 0] = True
    return image, photo, weight, valid


def run(function, image, target, weight, ssim_weight=0.2):
    image = image.clone().requires_grad_()
    loss = function(image, target, weight, ssim_weight)
    (3 * loss).backward()  # a factor, so that the gradient that comes in matters
    return loss.detach(), image.grad


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("masked", [False, True], ids=["whole", "invalid-pixels"])
@pytest.mark.parametrize("weighted", [False, True], ids=["plain", "weighted"])
def test_the_kernel_equals_the_definition(size, masked, weighted):
    image, photo, weight, valid = example(*size, masked=masked)
    weight = weight if weighted else None
    loss, gradient = run(photometric, image, Target(photo, valid), weight)
    double = None if weight is None else weight.double()
    true = run(plain_photometric, image.double(), Target(photo.double(), valid), double)
    torch.testing.assert_close(loss.double(), true[0], rtol=0, atol=ERROR_TOLERANCE)
    scale = float(true[1].abs().max())
    torch.testing.assert_close(gradient.double(), true[1], rtol=0, atol=GRADIENT_TOLERANCE * scale)


@pytest.mark.parametrize("ssim_weight", [0.0, 1.0])
def test_the_kernel_equals_the_definition_with_either_term_alone(ssim_weight):
    image, photo, weight, _ = example(20, 30)
    _, gradient = run(photometric, image, Target(photo), weight, ssim_weight)
    _, true = run(plain_photometric, image.double(), Target(photo.double()), weight.double(), ssim_weight)
    torch.testing.assert_close(gradient.double(), true, rtol=0, atol=GRADIENT_TOLERANCE * float(true.abs().max()))


@pytest.mark.parametrize("function", [photometric, photometric_paper])
def test_gradients_are_those_of_finite_differences(function):
    image, photo, weight, valid = example(4, 3, masked=True)
    image = image + 0.01  # away from the kink of |x - y|, where there is no derivative to compare with
    target = Target(photo.double(), valid)
    image = image.double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x: function(x, target, weight.double(), 0.2), image)


def test_the_papers_loss_teaches_the_mask_and_not_the_image():
    image, photo, mask, valid = example(4, 3, masked=True)
    image, target = (image + 0.01).double().requires_grad_(), Target(photo.double(), valid)
    mask = (0.1 + 0.8 * mask).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda m: photometric_of_mask(image, target, m, 0.2), mask)
    loss = photometric_of_mask(image, target, mask, 0.2)
    torch.testing.assert_close(loss, photometric_paper(image, target, mask, 0.2))
    loss.backward()
    assert image.grad is None and mask.grad[valid].abs().min() > 0
    learned = mask.grad.clone()
    photometric_paper(image, target, mask, 0.2).backward()  # the other way round
    assert image.grad[valid].abs().min() > 0 and torch.equal(mask.grad, learned)


def test_ssim_is_that_of_an_explicit_window():
    image, photo, _, _ = example(9, 14)
    loss = plain_photometric(image.double(), Target(photo.double()), None, 1.0)
    offsets = torch.arange(-5.0, 6.0, dtype=torch.float64)
    window = torch.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * 1.5**2))
    window = (window / window.sum())[None, None]

    def windowed(pixels):
        return torch.nn.functional.conv2d(pixels.permute(2, 0, 1)[:, None], window, padding=5)[:, 0]

    x, y = image.double(), photo.double()
    x_mean, y_mean = windowed(x), windowed(y)
    covariance = windowed(x * y) - x_mean * y_mean
    variances = windowed(x * x) - x_mean**2 + windowed(y * y) - y_mean**2
    ssim = (2 * x_mean * y_mean + 1e-4) * (2 * covariance + 9e-4)
    ssim = ssim / ((x_mean**2 + y_mean**2 + 1e-4) * (variances + 9e-4))
    assert float(loss) == pytest.approx(float(1 - ssim.mean()), abs=1e-12)  # both in float64


def test_a_mask_that_halves_the_weights_halves_the_loss():
    image, photo, _, _ = example(30, 20)
    target = Target(photo)
    whole, _ = run(photometric, image, target, None)
    half, _ = run(photometric, image, target, torch.full((30, 20), 0.5))
    assert float(half) == pytest.approx(0.5 * float(whole), rel=1e-6)  # halving is exact; the sum is in float64


def test_invalid_pixels_do_not_matter():
    image, photo, weight, valid = example(25, 31, masked=True)
    changed_image = torch.where(valid[..., None], image, torch.nan)
    changed_photo = torch.where(valid[..., None], photo, 0.5)
    first = run(photometric, image, Target(photo, valid), weight)
    second = run(photometric, changed_image, Target(changed_photo, valid), weight)
    assert torch.equal(first[0], second[0])
    assert torch.equal(first[1][valid], second[1][valid])
    assert not first[1][~valid].any()


@pytest.mark.parametrize("poison", [float("nan"), float("inf"), -float("inf")])
def test_a_poisoned_render_shows_in_the_loss(poison):
    image, photo, weight, _ = example(20, 20)
    image[3, 2, 1] = poison  # a pixel of weight 0: no mask may hide it
    assert not torch.isfinite(run(photometric, image, Target(photo), weight)[0])


def test_any_number_of_threads_gives_the_same_bits(on_threads):
    image, photo, weight, _ = example(600, 333)
    target = Target(photo)
    first, *others = on_threads((1, 2, 3), lambda: run(photometric, image, target, weight))
    for other in others:
        assert all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_the_papers_loss_multiplies_both_pictures_by_the_mask():
    image, photo, mask, _ = example(30, 24)
    loss, gradient = run(photometric_paper, image, Target(photo), mask)
    multiplied = run(plain_photometric, image * mask[..., None], Target(photo * mask[..., None]), None)
    torch.testing.assert_close(loss, multiplied[0], rtol=1e-6, atol=1e-7)  # one formula, two orders of rounding
    assert not gradient[mask == 0].any()


@pytest.mark.parametrize("shape", [(3, 40, 61), (1, 4, 30), (3, 1, 1)], ids=str)
def test_photos_and_renders_are_blurred_alike(shape):
    # Rows that do not follow each other.
    planes = torch.rand(*shape[:2], shape[2] + 2, generator=torch.Generator().manual_seed(1))[:, :, 1:-1]
    true = blur(planes.double())
    assert (blur(planes) - true).abs().max() < 5e-7 and (
        blur(planes.clone().requires_grad_()) - true
    ).abs().max() < 5e-7


@pytest.mark.parametrize("masked", [False, True], ids=["whole", "invalid-pixels"])
def test_a_photo_over_a_colour_is_the_photo_composed_with_it(masked):
    _, colours, empty, valid = example(30, 24, masked=masked)
    colour, gain = (0.2, 0.9, 0.5), torch.tensor([0.5, 1.2, 1.0])
    black = colours * (1 - empty[..., None])
    target = Target(black + empty[..., None], valid, empty)
    composed = Target(black * gain + empty[..., None] * torch.tensor(colour), valid)
    over = target.brightened(gain).over(colour)
    for name in ("planes", "padded", "mean", "mean_square"):
        # float32 of numbers up to 1.4.
        torch.testing.assert_close(getattr(over, name), getattr(composed, name), rtol=0, atol=1e-6)
    torch.testing.assert_close(target.planes, Target(black, valid).planes, rtol=0, atol=1e-6)


def test_a_photo_without_valid_pixels_is_refused():
    with pytest.raises(BadInput, match="no valid pixel"):
        Target(torch.zeros(4, 4, 3), torch.zeros(4, 4, dtype=torch.bool))


LINE, NUMBER = numba.float32[::1], numba.float32
LOOPS = {
    "_add_rows": (NUMBER, *(LINE,) * 7),
    "_compare": (numba.float32[:, ::1], *(LINE,) * 5, NUMBER, NUMBER, *(LINE,) * 4),
    "_blur_down": (numba.float32[:, ::1], numba.int64, LINE),
    "_combine": (numba.float32[:, ::1], *(LINE,) * 3, NUMBER, NUMBER, LINE),
}


@pytest.mark.parametrize("loop", LOOPS)
def test_loops_are_vectorised(loop):
    packed = re.findall(r"vfn?m(?:add|sub)\d+ps\s.*[yz]mm", assembly_of(getattr(photometric_cpu, loop), LOOPS[loop]))
    assert len(packed) >= 4  # what the shortest of these loops needs
