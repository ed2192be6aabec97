"""What the mask is taught to hide: colours that the place has in no light, but not tone,
shade or detail that is not learned yet."""

import pytest
import torch

from core.appearance import strangeness
from core.training.losses.mask_loss import mask_loss
from core.training.losses.photometric import Target

HEIGHT, WIDTH, CELL = 48, 64, 4
STRANGER = slice(6, 9), slice(3, 6)  # cells
SETTLED = 0.00625


def place() -> torch.Tensor:
    """(3, H, W): a wall of warm stone with blocks in other tints, dim enough to be lit up."""
    generator = torch.Generator().manual_seed(0)
    blocks = 0.2 + 0.3 * torch.rand(3, HEIGHT // 8, WIDTH // 8, generator=generator)
    stone = torch.tensor([1.1, 1.0, 0.8])[:, None, None] * blocks.mean(dim=0, keepdim=True)
    return (0.8 * stone + 0.2 * blocks).repeat_interleave(8, dim=1).repeat_interleave(8, dim=2)


def with_stranger(photo: torch.Tensor) -> torch.Tensor:
    rows, columns = (slice(side.start * CELL, side.stop * CELL) for side in STRANGER)
    photo = photo.clone()
    photo[:, rows, columns] = torch.tensor([0.5, 0.1, 0.5])[:, None, None] * photo[:, rows, columns].mean()
    return photo


def loss_of(mask: torch.Tensor, image: torch.Tensor, photo: torch.Tensor, regularisation: float) -> torch.Tensor:
    return mask_loss(mask, image, Target(photo.permute(1, 2, 0)), regularisation)


def best_mask(image: torch.Tensor, photo: torch.Tensor, regularisation: float = SETTLED) -> torch.Tensor:
    """(h, w): the mask that the loss asks for; image as (3, H, W).
    The loss is a parabola in each cell, with its least value a Newton step away."""

    def step_of(mask: torch.Tensor) -> torch.Tensor:
        mask.requires_grad_()
        (gradient,) = torch.autograd.grad(loss_of(mask, image.permute(1, 2, 0), photo, regularisation), mask)
        return gradient * mask.numel() / (2 * regularisation)

    start = torch.full((1, HEIGHT // CELL, WIDTH // CELL), 0.95)
    best = (start - step_of(start)).detach()
    assert step_of(best).abs().max() < 1e-5
    return best.detach()[0].clamp(0, 1)


def test_a_place_is_hidden_by_as_much_as_it_looks_strange():
    image, photo = place(), with_stranger(place())
    shown, wanted = (torch.nn.functional.avg_pool2d(picture, CELL) for picture in (image, photo))
    strange = strangeness.excess(shown, wanted)[0]
    assert strange.max() > 1
    torch.testing.assert_close(best_mask(image, photo, 0.1), 1 - 0.05 * strange / 0.2, rtol=0, atol=1e-5)


def test_people_in_other_colours_are_hidden_and_nothing_else():
    mask = best_mask(place(), with_stranger(place()))
    assert float(mask[STRANGER].max()) < 0.1
    mask[5:10, 2:7] = 1  # the cells beside are blurred with
    assert float(mask.min()) > 0.95


@pytest.mark.parametrize(
    "change",
    [
        lambda picture: 1.6 * picture,
        lambda picture: torch.tensor([1.3, 1.0, 0.7])[:, None, None] * picture + 0.08,
        lambda picture: picture * torch.linspace(1.0, 0.6, WIDTH),  # shade falls over it
        lambda picture: picture + 0.1 * (-1) ** torch.arange(WIDTH),  # detail finer than a cell
    ],
    ids=["exposure", "white balance", "shade", "detail"],
)
def test_in_another_light_nothing_but_strangers_is_hidden(change):
    assert float(best_mask(place(), change(place())).min()) > 0.9
    mask = best_mask(place(), change(with_stranger(place())))
    assert float(mask[STRANGER].mean()) < 0.25 and float(mask.mean()) > 0.85


def test_where_the_photo_is_black_nothing_is_learned():
    photo = place()
    photo[:, :, : WIDTH // 2] = 0
    mask = best_mask(place() + 0.2, photo)
    assert float(mask[:, : WIDTH // 2 // CELL - 1].min()) > 0.99


def test_a_photo_that_is_not_learned_yet_is_judged_by_its_own_errors():
    generator = torch.Generator().manual_seed(1)
    photo = torch.rand(3, HEIGHT // CELL, WIDTH // CELL, generator=generator)
    photo = photo.repeat_interleave(CELL, dim=1).repeat_interleave(CELL, dim=2)
    mask = best_mask(place(), photo)
    assert float((mask < 0.95).float().mean()) < 1 - strangeness.USUAL + 0.01


def test_what_is_drawn_where_a_photo_is_not_valid_teaches_nothing():
    valid = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    valid[:, : WIDTH // 4] = False
    target, mask = (
        Target(with_stranger(place()).permute(1, 2, 0), valid),
        torch.full((1, HEIGHT // CELL, WIDTH // CELL), 0.9),
    )
    image = place().permute(1, 2, 0)
    other = torch.where(valid[..., None], image, 1 - image)
    assert mask_loss(mask, image, target, SETTLED) == mask_loss(mask, other, target, SETTLED)


def test_the_gradient_is_right_and_the_image_gets_none():
    generator = torch.Generator().manual_seed(0)
    mask, image, photo = (
        torch.rand(shape, generator=generator).double() for shape in ((1, 3, 4), (12, 16, 3), (3, 12, 16))
    )
    assert torch.autograd.gradcheck(lambda mask: loss_of(mask, image, photo, 0.1), mask.requires_grad_())
    loss_of(mask, image.requires_grad_(), photo, 0.1).backward()
    assert image.grad is None
