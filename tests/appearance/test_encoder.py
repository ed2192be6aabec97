"""Encoder, attention and masks: shapes for any photo, and what each part does to its input."""

import pytest
import torch

from core.appearance.attention import ChannelAttention, MaskUNet, he_initialised
from core.appearance.encoder import CHANNELS, PhotoEncoder, PlainMask, band_colours, shrink
from core.appearance.mask_table import MaskTable
from core.errors import BadInput
from tests.small import whole_settings

SIZES = [(1, 1), (1, 7), (3, 301), (5, 5), (31, 33), (64, 64), (127, 170), (128, 129)]


def quarter(size: tuple[int, int]) -> tuple[int, int]:
    return tuple(-(-side // 4) for side in size)


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_photos_of_any_size_have_an_embedding_and_a_mask(size):
    embedding, mask = PhotoEncoder(whole_settings(embedding_size=7))(torch.rand(3, *size), True)
    assert embedding.shape == (7,)
    assert mask.shape == (1, *quarter(size))
    assert PlainMask()(torch.rand(3, *size)).shape == mask.shape
    assert embedding.isfinite().all() and mask.isfinite().all()


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_masks_start_near_one(level):
    for photo in (torch.full((3, 60, 91), level), torch.rand(3, 60, 91).mul(0.2).add(level * 0.8)):
        for mask in (PhotoEncoder(whole_settings())(photo, True)[1], PlainMask()(photo), MaskTable(4)(3, 15, 23)):
            assert mask.min() > 0.8
            assert 0.93 < mask.mean() < 0.99  # sigmoid(3) = 0.953


def test_every_part_of_the_encoder_learns_from_the_embedding():
    encoder = PhotoEncoder(whole_settings())
    embedding, _ = encoder(torch.rand(3, 40, 50), True)
    embedding.square().sum().backward()
    assert all(parameter.grad.any() for parameter in encoder.parameters())


def test_outside_photos_are_encoded_with_a_mask_of_one():
    encoder = PhotoEncoder(whole_settings())
    photo = torch.rand(3, 40, 50)
    outside, mask = encoder(photo, False)
    assert not torch.equal(outside, encoder(photo, True)[0])
    assert mask is not None
    torch.nn.init.zeros_(encoder.unet.up_2.weight)
    torch.nn.init.constant_(encoder.unet.up_2.bias, 50.0)  # sigmoid(50) is 1 in float32
    assert torch.equal(outside, encoder(photo, True)[0])


def test_mask_hides_a_region_from_the_embedding():
    encoder = PhotoEncoder(whole_settings(colour_bands=0))
    features = torch.rand(1, CHANNELS[-1], 8, 8)
    encoder.unet.forward = lambda refined: (torch.arange(8) < 4).float()[None, None, None].expand(1, 1, 8, 8)
    encoder.enc1.forward = lambda photo: features
    refined = encoder.channel_attention(features)
    expected = features.clone()
    expected[..., :4] += refined[..., :4]
    photo, ones = torch.rand(3, 32, 32), torch.ones(1, 1, 8, 8)
    assert torch.allclose(encoder(photo, True)[0], encoder.enc2(expected, photo, ones))


def test_colours_of_bands_are_means_of_what_is_static():
    photo = torch.rand(3, 32, 48)
    everything, upper = torch.ones(1, 1, 8, 12), torch.ones(1, 1, 8, 12)
    upper[..., 4:8, :6] = 0.0
    means = [part.mean((1, 2)) for part in photo.chunk(4, dim=1)]
    # float32 sums.
    assert torch.allclose(band_colours(photo, everything, 4), torch.stack(means, dim=1).flatten(), atol=1e-6)
    means[2], means[3] = (part[:, :, 24:].mean((1, 2)) for part in photo.chunk(4, dim=1)[2:])
    # What is hidden counts a millionth.
    assert torch.allclose(band_colours(photo, upper, 4), torch.stack(means, dim=1).flatten(), atol=1e-5)


def test_a_band_that_is_hidden_altogether_still_has_a_colour():
    assert torch.allclose(band_colours(torch.full((3, 32, 48), 0.25), torch.zeros(1, 1, 8, 12), 4), torch.tensor(0.25))


def test_nothing_is_learned_by_the_mask_from_colours_of_bands():
    assert not band_colours(torch.rand(3, 32, 48), torch.ones(1, 1, 8, 12).requires_grad_(), 4).requires_grad


def test_a_photo_lower_than_its_bands_has_colours():
    assert band_colours(torch.rand(3, 1, 7), torch.ones(1, 1, 1, 2), 4).shape == (12,)


def test_channel_attention_is_the_papers_formula():
    attention = ChannelAttention(8)
    features = torch.randn(1, 8, 5, 6)
    first, _, second = attention.shared
    average, maximum = features[0].flatten(1).mean(1), features[0].flatten(1).max(1).values
    logits = sum(second(torch.relu(first(pooled))) for pooled in (average, maximum))
    # Two orders of the same float32 sums of 30 numbers.
    assert torch.allclose(attention(features)[0], torch.sigmoid(logits)[:, None, None] * features[0], atol=1e-6)


def test_new_layers_keep_the_mean_square_of_their_input():
    kept = torch.relu(he_initialised(torch.nn.Conv2d(32, 32, 3))(torch.randn(1, 32, 60, 60))).square().mean()
    assert 0.9 < kept < 1.1  # a sixth with PyTorch's own weights


def test_unet_sees_fine_and_coarse():
    """A changed corner moves the mask there at once, and leaves the far corner alone."""
    unet = MaskUNet(4)
    features = torch.rand(1, 4, 41, 61)
    changed = features.clone()
    changed[..., :2, :2] += 1
    moved = (unet(changed) - unet(features)).abs()[0, 0]
    assert moved[:4, :4].max() > 0
    assert moved[-8:, -8:].max() == 0


def test_mask_table_tells_photos_and_places_apart():
    table = MaskTable(3)
    first, second = table(0, 6, 9), table(1, 6, 9)
    assert first.shape == (1, 6, 9)
    assert not torch.equal(first, second)
    assert first.unique().numel() == 54
    torch.testing.assert_close(table(0, 3, 5)[0, 1, 2], table(0, 1, 1)[0, 0, 0])  # the middle, at whatever size
    first.sum().backward()
    assert table.photos.grad[0].any() and not table.photos.grad[1:].any()


@pytest.mark.parametrize("size, side", [((300, 400), 64), ((401, 65), 64), ((640, 64), 64), ((640, 50), 50)])
def test_photos_of_any_shape_become_squares_and_are_never_enlarged(size, side):
    photo = torch.rand(3, *size)
    small = shrink(photo, 64)
    assert small.shape == (3, side, side)
    assert shrink(small, 64) is small
    assert small.min() >= photo.min() and small.max() <= photo.max()


def test_shrink_averages():
    photo = torch.rand(3, 64, 96)
    blocks = photo.unfold(1, 2, 2).unfold(2, 3, 3).mean((3, 4))
    assert torch.allclose(shrink(photo, 32), blocks, atol=1e-6)  # float32 means of six numbers
    assert torch.equal(shrink(torch.full((3, 101, 333), 0.25), 40), torch.full((3, 40, 40), 0.25))


def test_a_photo_without_pixels_is_refused():
    with pytest.raises(BadInput, match="5 x 0 px"):
        shrink(torch.zeros(3, 0, 5), 64)


def test_embeddings_start_apart_by_the_same_bits_for_any_number_of_threads(on_threads):
    photos = [torch.rand(3, 64, 86) for _ in range(20)]

    def found():
        torch.manual_seed(0)
        encoder = PhotoEncoder(whole_settings())
        encoder.initialise_embedding(photos)
        return encoder.enc2.embedding.weight

    first, *others = on_threads((1, 2, 3), found)
    for other in others:
        assert torch.equal(first, other)


def test_embeddings_start_around_zero_as_the_masks_of_the_start_give_them():
    encoder = PhotoEncoder(whole_settings())
    torch.nn.init.constant_(encoder.unet.up_2.bias, -2.0)
    photos = [torch.rand(3, 1, 1) * torch.rand(3, 32, 32) for _ in range(20)]
    encoder.initialise_embedding(photos)
    embeddings = torch.stack([encoder(photo, True)[0] for photo in photos])
    assert embeddings.mean(dim=0).abs().max() < 1e-3
    assert 0.5 < embeddings.std(dim=0).max() < 1


def test_what_next_to_equal_photos_differ_by_is_not_amplified():
    encoder, photo = PhotoEncoder(whole_settings()), torch.rand(3, 32, 32)
    photos = [photo + 1e-3 * torch.rand(3, 1, 1) for _ in range(20)]
    encoder.initialise_embedding(photos)
    assert torch.stack([encoder(each, True)[0] for each in photos]).std(dim=0).max() < 0.1
