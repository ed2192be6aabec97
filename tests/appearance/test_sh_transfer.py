"""G_phi: its definition, and the fast path that must equal it in values, gradients and on any number of threads."""

import pytest
import torch
from torch.func import functional_call

from core.appearance import sh_transfer, transfer_mlp
from core.appearance.sh_transfer import SHTransfer, TransferInput
from core.appearance.transfer_mlp import ROWS, plain_mlp
from core.errors import BadInput
from core.system.threads import threads_for_blocks
from tests.small import whole_settings


def transfer_of(**changes) -> SHTransfer:
    """A transfer whose last layer is awake, so that gradients of every layer count."""
    torch.manual_seed(3)
    transfer = SHTransfer(whole_settings(**{"transfer_width": 32, "sh_degree": 1, "embedding_size": 5} | changes))
    torch.nn.init.normal_(transfer.last.weight, std=0.3)
    for layer in (*transfer.layers, transfer.last):
        torch.nn.init.normal_(layer.bias, std=0.2)
    return transfer


def inputs_of(transfer: SHTransfer, rows: int, dtype=torch.float32) -> dict[str, torch.Tensor]:
    """Inputs with requires_grad where there is a gradient; the same numbers in any dtype."""
    generator = torch.manual_seed(rows)
    settings = transfer.settings
    made = {
        "sh": torch.randn(rows, transfer.coefficients // 3, 3, generator=generator).to(dtype).requires_grad_(),
        "means": torch.randn(rows, 3, generator=generator).to(dtype) * 2,
        "embedding": torch.randn(settings.embedding_size, generator=generator).to(dtype).requires_grad_(),
    }
    if settings.latent_size:
        made["latents"] = torch.randn(rows, settings.latent_size, generator=generator).to(dtype).requires_grad_()
    return made


def called(transfer: SHTransfer, sh, means, embedding, latents=None) -> torch.Tensor:
    return transfer(TransferInput(sh, means, latents), embedding)


def incoming(output: torch.Tensor) -> torch.Tensor:
    """A gradient to start from, not symmetric about 0:
    sums that cancel would measure nothing but their own rounding."""
    return torch.linspace(-0.5, 1, output.numel(), dtype=output.dtype).view_as(output)


def values_and_gradients(transfer: SHTransfer, inputs: dict) -> dict[str, torch.Tensor]:
    transfer.zero_grad()
    output = called(transfer, **inputs)
    (output * incoming(output)).sum().backward()
    found = {"output": output.detach()}
    found |= {name: tensor.grad for name, tensor in inputs.items() if tensor.requires_grad}
    return found | {name: parameter.grad.clone() for name, parameter in transfer.named_parameters()}


VARIANTS = [
    {"sh_degree": 0},
    {"sh_degree": 3, "transfer_width": 64},
    {"embedding_enters": "input", "transfer_layers": 4, "sh_degree": 2},
    {"embedding_enters": "input", "transfer_layers": 2},
    {"transfer_layers": 2, "latent_size": 3},
    {"latent_size": 3},
    {"sh_octaves": 2, "position_octaves": 0},
    {"detach_sh": True, "latent_size": 2},
    {"detach_sh": True},
]


@pytest.mark.parametrize("changes", VARIANTS, ids=str)
@pytest.mark.parametrize("rows", [0, 1, ROWS, 2 * ROWS + 77])
def test_fast_path_equals_the_definition(changes, rows):
    transfer = transfer_of(**changes)
    fast = values_and_gradients(transfer, inputs_of(transfer, rows))
    exact = values_and_gradients(transfer.double(), inputs_of(transfer, rows, torch.float64))
    assert fast.keys() == exact.keys()
    for name, expected in exact.items():
        if expected is None:  # no gradient at all: `detach_sh`
            assert fast[name] is None, name
            continue
        # float32 through four layers and sums of 2,000 rows: the plain path in float32 is off by up to 1e-5 as well.
        # A ReLU that rounds to the other side of 0 changes next to nothing: its input is as near to 0.
        limit = 2e-5 * float(expected.abs().max()) if expected.numel() else 0.0
        assert torch.allclose(fast[name].double(), expected, rtol=0, atol=limit), name


@pytest.mark.parametrize("enters", ["output", "input"])
def test_definition_passes_gradcheck(enters):
    small = {"latent_size": 2, "sh_octaves": 1, "transfer_width": 6, "position_octaves": 1, "embedding_size": 2}
    transfer = transfer_of(embedding_enters=enters, **small).double()
    inputs = inputs_of(transfer, 3, torch.float64)
    names = [name for name, _ in transfer.named_parameters()]

    def evaluate(sh, embedding, latents, *parameters):
        weights = dict(zip(names, parameters))
        return functional_call(transfer, weights, (TransferInput(sh, inputs["means"], latents), embedding))

    leaves = inputs["sh"], inputs["embedding"], inputs["latents"], *transfer.parameters()
    assert torch.autograd.gradcheck(evaluate, leaves)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_gradient_into_means_and_detached_sh(dtype):
    transfer = transfer_of(detach_sh=True).to(dtype)
    inputs = inputs_of(transfer, 5, dtype)
    inputs["means"].requires_grad_()
    called(transfer, **inputs).sum().backward()
    assert inputs["means"].grad is None
    assert inputs["sh"].grad is None
    assert inputs["embedding"].grad.abs().sum() > 0


def test_bit_identical_on_any_number_of_threads(on_threads):
    transfer = transfer_of(latent_size=2)

    @threads_for_blocks()  # as training; torch's own products differ by their threads on some processors
    def found():
        return values_and_gradients(transfer, inputs_of(transfer, 7 * ROWS + 5))

    first, *others = on_threads((1, 2, 3, 5), found)
    for other in others:
        for name, expected in first.items():
            assert torch.equal(other[name], expected), name


def test_a_gaussian_does_not_depend_on_the_others():
    transfer = transfer_of()
    inputs = inputs_of(transfer, 2 * ROWS + 300)
    everything = called(transfer, **inputs)
    rows = torch.randperm(len(everything))[: ROWS + 17]
    assert torch.equal(
        transfer(TransferInput(inputs["sh"][rows], inputs["means"][rows]), inputs["embedding"]), everything[rows]
    )
    with torch.no_grad():
        assert torch.equal(called(transfer, **inputs), everything)
    poisoned = inputs["sh"].detach().clone()
    poisoned[5] = torch.nan
    output = called(transfer, **inputs | {"sh": poisoned})
    assert output[5].isnan().all()
    assert torch.equal(output[6:], everything[6:])


@pytest.mark.parametrize("trained", [(), ("layers.1.weight", "layers.3.bias")], ids=str)
def test_frozen_weights_change_nothing_for_the_rest(trained):
    """As when an embedding is refined through a finished transfer."""
    transfer = transfer_of()
    inputs = inputs_of(transfer, ROWS + 1)
    everything = values_and_gradients(transfer, inputs)
    for name, parameter in transfer.named_parameters():
        parameter.requires_grad_(name in trained)
        parameter.grad = None
    leaves = {name: tensor.detach() for name, tensor in inputs.items()}
    leaves["embedding"].requires_grad_()
    (called(transfer, **leaves) * incoming(everything["output"])).sum().backward()
    assert torch.equal(leaves["embedding"].grad, everything["embedding"])
    for name, parameter in transfer.named_parameters():
        assert (parameter.grad is None) if name not in trained else torch.equal(parameter.grad, everything[name])


def test_extremes_stay_finite_and_bounded():
    transfer = transfer_of(residual_bound=2.5)
    inputs = inputs_of(transfer, 40)
    inputs["sh"] = (inputs["sh"].detach() * 1e4).requires_grad_()
    inputs["means"] = inputs["means"] * 1e6
    found = values_and_gradients(transfer, inputs)
    assert found["output"].abs().max() <= 2.5
    assert found["output"].abs().max() > 2.4  # the bound was reached, so it was what held
    for name, value in found.items():
        assert value.isfinite().all(), name


def test_starts_near_zero_but_not_dead():
    torch.manual_seed(0)
    transfer = SHTransfer(whole_settings())
    inputs = inputs_of(transfer, 500)
    found = values_and_gradients(transfer, inputs)
    assert found["output"].abs().max() < 0.1  # in colour 0.1 * Y_0: 7 of 255 at worst; the typical residual is 0.008
    assert all(found[name].any() for name, _ in transfer.named_parameters())


def test_uses_the_fast_path_for_float32_only(monkeypatch):
    transfer = transfer_of()
    used = []

    def plain(*arguments):
        used.append("plain")
        return plain_mlp(*arguments)

    monkeypatch.setattr(sh_transfer, "chunked_mlp", plain)
    called(transfer, **inputs_of(transfer, 3))
    assert used == []
    called(transfer.double(), **inputs_of(transfer, 3, torch.float64))
    assert used == ["plain"]


def test_hidden_layers_are_kept_only_for_a_backward_pass(monkeypatch):
    transfer, kept = transfer_of(), []
    honest = transfer_mlp._evaluated
    monkeypatch.setattr(transfer_mlp, "_evaluated", lambda *given: kept.append(honest(*given)) or kept[-1])
    called(transfer, **inputs_of(transfer, 5))
    with torch.no_grad():
        called(transfer, **inputs_of(transfer, 5))
    assert [evaluated.kept.shape[1] > 0 for evaluated in kept] == [True, False]


def test_the_embedding_has_its_gradient_before_the_hidden_layers_do():
    """A training step starts to teach the encoder then, beside the rest."""
    transfer, order = transfer_of(embedding_enters="output"), []
    inputs = inputs_of(transfer, 3)
    embedding = inputs["embedding"].detach().requires_grad_()
    embedding.register_hook(lambda gradient: order.append("embedding"))
    for layer in transfer.layers:
        layer.weight.register_hook(lambda gradient: order.append("hidden"))
    called(transfer, **inputs | {"embedding": embedding}).sum().backward()
    assert order == ["embedding"] + ["hidden"] * len(transfer.layers)


@pytest.mark.parametrize(
    "wrong, words",
    [
        ({"sh": torch.zeros(2, 9, 3)}, "12 SH coefficients and got 27"),
        ({"latents": torch.zeros(2, 4)}, "0 latent numbers and got 4"),
        ({"embedding": torch.zeros(6)}, "5 embedding numbers and got 6"),
    ],
)
def test_wrong_sizes_are_refused_by_name(wrong, words):
    transfer = transfer_of()
    with pytest.raises(BadInput, match=words):
        called(transfer, **inputs_of(transfer, 2) | wrong)


def test_chunks_and_the_whole_agree(monkeypatch):
    """What does not fit into memory is computed twice, a chunk at a time:
    the same but for the order of sums in float64."""
    torch.manual_seed(0)
    model = SHTransfer(whole_settings()).double()
    sh, means, embedding = torch.randn(50, 4, 3).double(), torch.randn(50, 3).double(), torch.randn(16).double()
    outcomes, calls = [], []
    for limit in (transfer_mlp.CHUNK_BYTES, 20_000):
        monkeypatch.setattr(transfer_mlp, "CHUNK_BYTES", limit)
        monkeypatch.setattr(
            transfer_mlp, "plain_mlp", lambda *arguments: calls.append(len(arguments[0])) or plain_mlp(*arguments)
        )
        base = sh.clone().requires_grad_()
        output = model(TransferInput(base, means), embedding)
        outcomes.append([output, *torch.autograd.grad((output**2).sum(), [base, *model.parameters()])])
    assert calls[0] == 50 and max(calls[1:]) < 25 and sum(calls[1:]) == 100  # forward, and again on the way back
    for whole, pieces in zip(*outcomes, strict=True):
        torch.testing.assert_close(whole, pieces, rtol=1e-10, atol=1e-12)
