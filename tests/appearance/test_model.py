"""The appearance model: what the settings build, and looks, transfer, bake and the neutral look."""

from itertools import product

import pytest
import safetensors.torch
import torch

from core.appearance.encoder import shrink
from core.appearance.model import LEAST_WINDOW, MEAN_WINDOW_ROUNDS, AppearanceModel
from core.appearance.sh_transfer import TransferInput
from core.errors import BadInput
from core.scene.splats import Splats
from tests.small import whole_settings

PHOTOS = [f"{index}.jpg" for index in range(5)]
SMALL = {"sh_degree": 1, "transfer_width": 16, "encoder_side_px": 32, "embedding_size": 6}


def model_of(**changes) -> AppearanceModel:
    """A model whose transfers are awake: their last layers start at (nearly) zero."""
    torch.manual_seed(2)
    model = AppearanceModel(whole_settings(**SMALL | changes), PHOTOS)
    if changes.get("appearance") == "exposure":
        torch.nn.init.normal_(model.sh_transfer.map.weight, std=0.3)
    elif model.sh_transfer is not None:
        torch.nn.init.normal_(model.sh_transfer.last.weight, std=0.3)
    return model


def splats_of(count: int, coefficients: int = 4) -> Splats:
    torch.manual_seed(count)
    return Splats(
        torch.randn(count, 3), torch.randn(count, 4), torch.randn(count, 3), torch.randn(count),
        torch.randn(count, coefficients, 3),
    )  # fmt: skip


def parts(model: AppearanceModel) -> set[str]:
    """The learned parts that exist, two levels deep inside the encoder."""
    return {name.removeprefix("encoder.").split(".")[0] for name, _ in model.named_parameters()}


ENC1, CAM, UNET, ENC2 = "enc1", "channel_attention", "unet", "enc2"
TABLE, MASKS, TRANSFER = "embedding_table", "mask_network", "sh_transfer"


@pytest.mark.parametrize(
    "changes, expected",
    [
        ({}, {ENC1, CAM, UNET, ENC2, TRANSFER}),
        ({"channel_attention": False}, {ENC1, UNET, ENC2, TRANSFER}),
        ({"transients": "off"}, {ENC1, ENC2, TRANSFER}),
        ({"transients": "off", "mask": "mlp"}, {ENC1, ENC2, TRANSFER}),
        ({"mask": "cnn"}, {ENC1, CAM, ENC2, MASKS, TRANSFER}),
        ({"mask": "mlp"}, {ENC1, CAM, ENC2, MASKS, TRANSFER}),
        ({"embedding": "glo"}, {ENC1, CAM, UNET, TABLE, TRANSFER}),
        ({"embedding": "glo", "mask": "mlp"}, {TABLE, MASKS, TRANSFER}),
        ({"embedding": "glo", "transients": "off"}, {TABLE, TRANSFER}),
        ({"appearance": "exposure"}, {ENC1, CAM, UNET, ENC2, TRANSFER}),
        ({"appearance": "off"}, {ENC1, CAM, UNET}),
        ({"appearance": "off", "mask": "cnn"}, {MASKS}),
        ({"appearance": "off", "embedding": "glo", "mask": "mlp"}, {MASKS}),
        ({"appearance": "off", "transients": "off"}, set()),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else " ".join(sorted(value)),
)
def test_only_what_is_needed_is_built(changes, expected):
    model = model_of(**changes)
    assert parts(model) == expected
    # What is built is used: every parameter gets a gradient from a look and a transfer (tables: from their own row).
    look = model.read(torch.rand(3, 40, 50), 2)
    loss = 0.0 if look.mask is None else look.mask.square().sum()
    splats = splats_of(30)
    output, _ = model.transfer(TransferInput(splats.sh, splats.means), look.embedding)
    if expected:
        (loss + output.square().sum()).backward()
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None and parameter.grad.any(), name


@pytest.mark.parametrize(
    "appearance, embedding, transients, mask",
    list(product(("off", "exposure", "full"), ("encoder", "glo"), ("off", "on"), ("attention", "cnn", "mlp"))),
)
def test_looks_of_every_combination(appearance, embedding, transients, mask):
    model = model_of(appearance=appearance, embedding=embedding, transients=transients, mask=mask)
    inside, outside = (model.read(torch.rand(3, 37, 81), photo) for photo in (0, None))
    assert inside.embedding.shape == outside.embedding.shape == (6,)
    assert (inside.mask is None) == (transients == "off")
    assert (outside.mask is None) == (transients == "off" or mask == "mlp")  # a table knows no photo from outside
    if inside.mask is not None:
        assert inside.mask.shape == (1, 8, 8)  # 37 x 81 shrinks to 32 x 32


def test_a_large_photo_has_the_look_of_its_shrunken_copy():
    model = model_of()
    photo = torch.rand(3, 90, 70)
    assert torch.equal(model.read(photo, 1).embedding, model.read(shrink(photo, 32), 1).embedding)


@pytest.mark.parametrize("mask", ["attention", "cnn", "mlp"])
def test_look_does_not_depend_on_the_number_of_threads(mask, on_threads):
    model = model_of(encoder_side_px=128, mask=mask)
    photo = torch.rand(3, 128, 171)
    first, *others = on_threads((1, 2, 4), lambda: model.read(photo, 1))
    for other in others:
        assert torch.equal(other.embedding, first.embedding) and torch.equal(other.mask, first.mask)


def test_glo_gives_rows_inside_and_the_mean_outside():
    model = model_of(embedding="glo", transients="off")
    model.remember(torch.arange(6.0), 0)
    assert torch.equal(model.read(torch.rand(3, 9, 9), 3).embedding, model.embedding_table[3])
    assert torch.equal(model.read(torch.rand(3, 9, 9)).embedding, torch.arange(6.0))


@pytest.mark.parametrize("photo", [-1, 5])
def test_a_photo_that_is_not_there_is_refused(photo):
    with pytest.raises(BadInput, match=f"no photo {photo} among 5"):
        model_of().read(torch.rand(3, 8, 8), photo)


def test_transfer_honours_residual_and_detach_sh():
    splats, embedding = splats_of(50), torch.randn(6)

    def outcome(**changes):
        sh = splats.sh.clone().requires_grad_()
        output, residual = model_of(**changes).transfer(TransferInput(sh, splats.means), embedding)
        output.sum().backward()
        return output, residual, sh.grad, sh

    output, residual, gradient, sh = outcome()
    assert torch.equal(output, sh + residual)
    assert not torch.equal(gradient, torch.ones_like(sh))
    output, residual, gradient, _ = outcome(detach_sh=True)
    assert torch.equal(gradient, torch.ones_like(sh))
    direct, none, _, _ = outcome(residual=False)
    assert none is None
    assert torch.equal(direct, residual)
    output, none, _, sh = outcome(appearance="off")
    assert none is None
    assert output is sh


@pytest.mark.parametrize(
    "changes", [{}, {"latent_size": 3}, {"residual": False}, {"appearance": "exposure"}, {"appearance": "off"}], ids=str
)
def test_bake_equals_transfer_bit_for_bit(changes):
    model = model_of(**changes)
    splats, embedding = splats_of(2600), torch.randn(6)
    latents = torch.randn(2600, 3) if "latent_size" in changes else None
    live = model.transfer(TransferInput(splats.sh, splats.means, latents), embedding)[0]
    baked = model.bake(splats, embedding, latents)
    assert torch.equal(baked.sh, live)
    assert not baked.sh.requires_grad
    assert torch.equal(baked.means, splats.means)
    visible = torch.arange(0, 2600, 3)
    part = None if latents is None else latents[visible]
    assert torch.equal(
        model.transfer(TransferInput(splats.sh[visible], splats.means[visible], part), embedding)[0], live[visible]
    )
    assert len(model.bake(splats[:0], embedding, None if latents is None else latents[:0])) == 0


@pytest.mark.parametrize("changes", [{}, {"embedding_enters": "input"}, {"residual": False}], ids=str)
def test_changed_weights_bake_as_they_render_and_learn(changes):
    """The gradient of a change is that of the weight; the model keeps its own."""
    model, splats, embedding = model_of(**changes).requires_grad_(False), splats_of(100), torch.randn(6)
    kept = model.transfer(TransferInput(splats.sh, splats.means), embedding)[0]
    model.met_embeddings, model.remembered = torch.randn(3, 6), torch.tensor(3)
    names = model.hidden_weights | model.given_spread()
    assert ("last.bias" in names) == (changes != {"embedding_enters": "input"})
    moved = {name: 0.05 * torch.randn_like(weight) for name, weight in names.items()}
    for change in moved.values():
        change.requires_grad_()
    live = model.transfer(TransferInput(splats.sh, splats.means), embedding, changes=moved)[0]
    live.sum().backward()
    assert torch.equal(model.bake(splats, embedding, changes=moved).sh, live.detach()) and not torch.equal(live, kept)
    assert torch.equal(model.transfer(TransferInput(splats.sh, splats.means), embedding, changes={})[0], kept)
    with torch.no_grad():
        for name, change in moved.items():
            model.sh_transfer.get_parameter(name).add_(change)
    model.requires_grad_()
    whole = model.transfer(TransferInput(splats.sh, splats.means), embedding)[0]
    whole.sum().backward()
    assert torch.equal(whole, live)
    for name, change in moved.items():
        assert torch.equal(change.grad, model.sh_transfer.get_parameter(name).grad) and change.grad.any(), name


def test_given_weights_differ_as_widely_as_looks_do():
    """By standard deviation; a single look has none, nor do embeddings that are an input or give an affine map."""
    model = model_of()
    model.met_embeddings, model.remembered = torch.randn(1, 6), torch.tensor(1)
    assert not model.given_spread()
    model.met_embeddings = torch.randn(4, 6)
    expected = torch.stack([model.sh_transfer.last(embedding) for embedding in model.met_embeddings]).std(dim=0)
    torch.testing.assert_close(model.given_spread(), {"last.bias": expected.detach()})
    table = model_of(embedding="glo", transients="off")
    table.remember(table.embedding_table[0], 0)
    expected = table.sh_transfer.last(table.embedding_table).std(dim=0)
    torch.testing.assert_close(table.given_spread(), {"last.bias": expected.detach()})
    for changes in ({"embedding_enters": "input"}, {"appearance": "exposure"}, {"appearance": "off"}):
        other = model_of(**changes)
        other.met_embeddings, other.remembered = torch.randn(4, 6), torch.tensor(4)
        assert not other.given_spread() and bool(other.hidden_weights) == ("appearance" not in changes)


def test_bake_does_not_touch_the_scene():
    splats = splats_of(10)
    before = splats.sh.clone()
    baked = model_of().bake(splats, torch.randn(6))
    assert torch.equal(splats.sh, before)
    assert not torch.equal(baked.sh, before)


@pytest.mark.parametrize("photos, window", [(5, LEAST_WINDOW), (50, 50 * MEAN_WINDOW_ROUNDS)])
def test_neutral_look_is_a_corrected_running_mean(photos, window):
    model = AppearanceModel(whole_settings(**SMALL), [f"{number}.jpg" for number in range(photos)])
    decay = 1 - 1 / window
    seen = torch.randn(30, 6)
    assert not model.mean_embedding.any()
    for number, embedding in enumerate(seen):
        model.remember(embedding.requires_grad_(), number % photos)
    weights = decay ** torch.arange(29, -1, -1)
    expected = (weights[:, None] * seen.detach()).sum(0) / weights.sum()
    assert torch.allclose(model.mean_embedding, expected, atol=1e-6)  # thirty float32 roundings
    assert not model.mean_embedding.requires_grad


def test_photos_not_yet_seen_count_as_the_first_one_seen():
    model = model_of()
    first, second = torch.randn(2, 6)
    model.remember(first, 3)
    assert torch.equal(model.met_embeddings, first.repeat(5, 1))
    model.remember(second, 0)
    assert torch.equal(model.met_embeddings, torch.stack([second, *[first] * 4]))


def test_remembering_an_embedding_does_not_change_earlier_looks():
    model = model_of(embedding="glo", transients="off")
    model.remember(torch.ones(6), 0)
    look = model.read(torch.rand(3, 8, 8))
    model.remember(torch.zeros(6), 0)
    assert torch.equal(look.embedding, torch.ones(6))


def test_a_photo_from_outside_is_held_within_the_known_range(monkeypatch):
    """It is moved towards the mean of the known embeddings;
    embeddings within the range, and those of training photos, do not change by a bit."""
    model = model_of()
    directions = torch.linalg.qr(torch.randn(6, 6)).Q
    met = 1.5 + torch.randn(5, 3).clamp(-2, 2) * torch.tensor([3.0, 1.0, 0.2]) @ directions[:3]  # in a plane of three
    outside = torch.full((6,), 1.5) + 50 * directions[0] + 7 * directions[4]

    def given(embedding, photo=None):
        monkeypatch.setattr(model.encoder, "forward", lambda picture, masked=True: (embedding, None))
        return model.read(torch.rand(3, 8, 8), photo).embedding

    assert torch.equal(given(outside), outside)  # before anything was met
    model.remember(met[0], 0)
    assert torch.allclose(given(outside), met[0], atol=1e-6)  # one photo has one look
    for photo, embedding in enumerate(met):
        model.remember(embedding, photo)
    assert torch.equal(given(outside, 2), outside)
    for inside in (met.mean(dim=0), *met):
        assert torch.equal(given(inside), inside)
    away, held = outside - met.mean(dim=0), given(outside) - met.mean(dim=0)
    assert torch.cosine_similarity(held, away, dim=0) > 1 - 1e-6
    farthest = (met - met.mean(dim=0)).norm(dim=1).max()
    assert farthest / 2 < held.norm() < 1.5 * farthest < away.norm() / 4
    assert torch.allclose(given(given(outside)), given(outside), atol=1e-5)
    assert max(map(model.known_range().distance, met)) == 1 and model.known_range().distance(outside) > 4
    assert model.known_range().distance(given(outside)) == pytest.approx(1, abs=1e-5)
    model.remember(outside, 0)  # a photo like it was met: now it is within the range
    assert torch.allclose(given(outside), outside, atol=1e-4)


def test_the_known_range_of_a_finished_model_is_that_of_its_final_embeddings():
    model = model_of()
    model.remember(torch.randn(6), 2)
    met, state = model.met_embeddings.clone(), model.state_dict().keys()
    masked, unmasked = torch.randn(2, 5, 6)
    model.use_final_embeddings(masked, unmasked)
    assert (
        torch.equal(model.known_embeddings, torch.cat([masked, unmasked]))
        and max(map(model.known_range().distance, model.known_embeddings)) == 1
    )
    assert torch.equal(model.met_embeddings, met) and model.state_dict().keys() == state


def test_a_photo_from_outside_is_encoded_as_if_all_of_it_were_static():
    model, photo = model_of(), torch.rand(3, 40, 50)
    with torch.no_grad():
        whole, masked = (
            model.encoder(shrink(photo, model.settings.encoder_side_px), masked)[0] for masked in (False, True)
        )
    assert torch.equal(model.embedding_from_outside(photo), whole)
    assert not torch.allclose(whole, masked, atol=1e-3)
    table = model_of(embedding="glo", transients="off")
    assert torch.equal(table.embedding_from_outside(photo), table.mean_embedding)


@pytest.mark.parametrize("changes", [{}, {"embedding": "glo", "mask": "mlp"}, {"appearance": "exposure"}], ids=str)
def test_state_survives_a_safetensors_file(changes):
    model = model_of(**changes)
    model.remember(torch.randn(6), 2)
    saved = safetensors.torch.load(safetensors.torch.save(model.state_dict()))
    torch.manual_seed(99)
    other = AppearanceModel(model.settings, PHOTOS)
    other.load_state_dict(saved)
    photo = torch.rand(3, 40, 33)
    mine, theirs = (each.read(photo, 1) for each in (model, other))
    assert torch.equal(mine.embedding, theirs.embedding) and torch.equal(mine.mask, theirs.mask)
    assert torch.equal(model.mean_embedding, other.mean_embedding)
    assert model.remembered == other.remembered
