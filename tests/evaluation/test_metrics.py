"""PSNR, SSIM and mask overlap against their formulas and by hand."""

import math

import pytest
import torch

from core.evaluation.metrics import mask_iou, psnr, quantised, ssim


def picture(height=24, width=31, seed=0):
    return quantised(torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed)))


def explicit_ssim(x, y):
    """SSIM of one channel, window by window, in plain loops."""
    offsets = [i - 5 for i in range(11)]
    taps = torch.tensor([math.exp(-(i * i + j * j) / 4.5) for i in offsets for j in offsets], dtype=torch.float64)
    taps = (taps / taps.sum()).reshape(11, 11)
    values = []
    for top in range(x.shape[0] - 10):
        for left in range(x.shape[1] - 10):
            a, b = x[top : top + 11, left : left + 11], y[top : top + 11, left : left + 11]
            a_mean, b_mean = (taps * a).sum(), (taps * b).sum()
            a_variance, b_variance = (taps * (a - a_mean) ** 2).sum(), (taps * (b - b_mean) ** 2).sum()
            covariance = (taps * (a - a_mean) * (b - b_mean)).sum()
            top_part = (2 * a_mean * b_mean + 1e-4) * (2 * covariance + 9e-4)
            values.append(top_part / ((a_mean**2 + b_mean**2 + 1e-4) * (a_variance + b_variance + 9e-4)))
    return float(torch.stack(values).mean())


def test_quantised_pictures_are_those_of_8_bit_files():
    values = torch.tensor([-0.3, 0.0, 0.4999 / 255, 0.5001 / 255, 0.7, 1.0, 1.8]).reshape(1, 7, 1).expand(1, 7, 3)
    assert (quantised(values)[0, :, 0] * 255).round().tolist() == [0, 0, 0, 1, 178, 255, 255]
    assert torch.equal(quantised(quantised(values)), quantised(values))


def test_psnr_of_a_known_error():
    photo = torch.full((5, 6, 3), 0.5)
    assert psnr(photo + 0.1, photo) == pytest.approx(20.0, abs=1e-5)  # 0.1 is not exact in float32
    assert psnr(photo, photo) == 100.0


def test_psnr_counts_valid_pixels_only():
    photo = torch.zeros(4, 4, 3)
    image, valid = photo + 0.1, torch.ones(4, 4, dtype=torch.bool)
    image[0], valid[0] = 1.0, False
    assert psnr(image, photo, valid) == pytest.approx(20.0, abs=1e-5)
    assert psnr(image, photo) < 10


def test_a_poisoned_render_has_no_psnr():
    image = picture()
    image[2, 3, 1] = math.nan
    assert math.isnan(psnr(image, picture())) and math.isnan(ssim(image, picture()))


def test_ssim_is_that_of_explicit_windows():
    x, y = picture(13, 15).double(), picture(13, 15, seed=1).double()
    expected = sum(explicit_ssim(x[..., channel], y[..., channel]) for channel in range(3)) / 3
    assert ssim(x, y) == pytest.approx(expected, abs=1e-12)  # both in float64


def test_ssim_counts_windows_of_valid_pixels_only():
    photo = picture(30, 40)
    image, valid = photo.clone(), torch.ones(30, 40, dtype=torch.bool)
    image[:, 30:], valid[:, 30:] = 0, False
    assert ssim(image, photo, valid) == pytest.approx(1.0, abs=1e-12)
    assert ssim(image, photo) < 0.9
    valid[:, ::10] = False
    assert ssim(image, photo, valid) is None  # no window is left whole


@pytest.mark.parametrize("size", [(10, 40), (40, 10), (1, 1), (11, 11)])
def test_an_ssim_needs_room_for_one_window(size):
    assert (ssim(picture(*size), picture(*size, seed=1)) is None) == (min(size) < 11)


def test_mask_iou_by_hand():
    static = torch.ones(4, 4, dtype=torch.bool)
    static[:2] = False  # the upper 8 pixels are hidden
    mask = torch.full((4, 4), 0.51)
    mask[1:3] = 0.49  # 8 pixels, 4 of them right
    assert mask_iou(mask, static) == pytest.approx(4 / 12)
    assert mask_iou(static.float(), static) == 1.0
    assert mask_iou(torch.ones(4, 4), static) == 0.0


def test_masks_of_different_sizes_are_compared_at_the_truths():
    static = torch.ones(16, 24, dtype=torch.bool)
    static[:, :8] = False
    mask = torch.ones(4, 6)
    mask[:, :2] = 0
    assert mask_iou(mask, static) == 1.0


def test_nothing_hidden_and_nothing_predicted_is_full_agreement():
    assert mask_iou(torch.ones(3, 3), torch.ones(9, 9, dtype=torch.bool)) == 1.0
