"""G_phi and the encoder on values that no one would draw on purpose."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from core.appearance.model import AppearanceModel
from core.appearance.sh_transfer import TransferInput
from tests.small import whole_settings

ROWS = 9
EXTREMES = [0.0, -0.0, 1e-45, -1e-38, 1.0, -1e6, 1e18, -3e38]
POISON = [float("nan"), float("inf"), float("-inf")]
few = settings(max_examples=25, derandomize=True, deadline=None, database=None)
places = st.tuples(st.sampled_from(["sh", "means", "latents"]), st.integers(0, ROWS - 1), st.integers(0, 2))


def model(**changes) -> AppearanceModel:
    torch.manual_seed(0)
    made = AppearanceModel(whole_settings(sh_degree=1, latent_size=3, encoder_side_px=16, **changes), ["a", "b"])
    if made.sh_transfer is not None and hasattr(made.sh_transfer, "layers"):
        torch.nn.init.normal_(made.sh_transfer.last.weight, std=0.5)  # as if trained
    return made


MODELS = {mode: model(appearance=mode) for mode in ("full", "exposure")}


def inputs(values) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    shapes = {"sh": (ROWS, 4, 3), "means": (ROWS, 3), "latents": (ROWS, 3)}
    made = {name: torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    for (name, row, column), value in values:
        made[name][row].view(-1)[column] = value
    return made


@few
@given(
    values=st.lists(st.tuples(places, st.sampled_from(EXTREMES + POISON)), max_size=6),
    mode=st.sampled_from(list(MODELS)),
)
def test_a_poisoned_gaussian_keeps_its_poison_to_itself(values, mode):
    """Bit for bit: what is baked for the others is what is baked without it."""
    chosen, embedding = MODELS[mode], torch.linspace(-2, 2, 16)
    clean, given_ = inputs([]), inputs(values)
    spoilt = torch.zeros(ROWS, dtype=torch.bool)
    spoilt[[row for (_, row, _), _ in values]] = True
    with torch.no_grad():
        expected, _ = chosen.transfer(TransferInput(**clean), embedding)
        baked, _ = chosen.transfer(TransferInput(**given_), embedding)
    assert torch.equal(baked[~spoilt], expected[~spoilt])


@few
@given(
    values=st.lists(st.tuples(places, st.sampled_from(EXTREMES[:-2])), max_size=6),
    scale=st.sampled_from([0.0, 1e-40, 1.0, 1e6]),
)
def test_finite_gaussians_and_embeddings_have_bounded_residuals_and_finite_gradients(values, scale):
    chosen, given_ = MODELS["full"], inputs(values)
    embedding = (scale * torch.linspace(-1, 1, 16)).requires_grad_()
    given_["sh"].requires_grad_()
    _, residual = chosen.transfer(TransferInput(**given_), embedding)
    assert torch.isfinite(residual).all() and residual.abs().max() <= chosen.settings.residual_bound
    residual.square().sum().backward()
    for tensor in (given_["sh"], embedding, *chosen.sh_transfer.parameters()):
        assert torch.isfinite(tensor.grad).all()
    chosen.zero_grad()


@few
@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    level=st.sampled_from([0.0, 1e-45, 1 / 255, 1.0, 1.4]),
    noise=st.sampled_from([0.0, 0.5]),
)
def test_any_photo_has_an_embedding_a_mask_and_finite_gradients(height, width, level, noise):
    """Black, white, of one pixel, brightened beyond 1."""
    chosen = MODELS["full"]
    photo = level + noise * torch.rand(3, height, width, generator=torch.Generator().manual_seed(height * 40 + width))
    look = chosen.read(photo, 0)
    assert torch.isfinite(look.embedding).all() and torch.isfinite(chosen.embedding_from_outside(photo)).all()
    assert ((look.mask >= 0) & (look.mask <= 1)).all()
    (look.embedding.square().sum() + look.mask.square().sum()).backward()
    for name, weight in chosen.encoder.named_parameters():
        assert weight.grad is None or torch.isfinite(weight.grad).all(), name
    chosen.zero_grad()


@few
@given(levels=st.lists(st.sampled_from([0.0, 0.25, 1.0]), min_size=1, max_size=4))
def test_photos_of_any_spread_start_with_embeddings_of_order_one(levels):
    """One photo, equal ones, black ones: no spread is amplified without end."""
    chosen = MODELS["full"]
    photos = [torch.full((3, 16, 20), level) for level in levels]
    chosen.encoder.initialise_embedding(photos)
    for photo in (*photos, photos[0] * 0.9, torch.full((3, 16, 20), 0.5)):
        assert chosen.read(photo, 0).embedding.abs().max() < 100
