"""Every stage of appearance against finite differences, in float64."""

import pytest
import torch

from core.appearance.attention import ChannelAttention, MaskUNet
from core.appearance.encoder import PhotoEncoder
from core.appearance.exposure import ExposureTransfer
from core.appearance.mask_table import MaskTable
from core.appearance.positional_encoding import encode
from core.appearance.sh_transfer import TransferInput
from tests.small import whole_settings

# fast_mode projects on random directions: one pair of evaluations instead of one a number.
CHECK = {"fast_mode": True, "atol": 1e-6, "rtol": 1e-4}


def randn(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(7), dtype=torch.float64)


def checked(stage, *inputs: torch.Tensor) -> bool:
    """gradcheck by the inputs and by the weights of the stage, which are moved in place."""
    weights = list(stage.parameters()) if isinstance(stage, torch.nn.Module) else []
    return torch.autograd.gradcheck(
        lambda *values: stage(*values[: len(inputs)]), [x.requires_grad_() for x in inputs] + weights, **CHECK
    )


@pytest.mark.parametrize("masked", [True, False])
def test_the_encoder_passes_gradcheck(masked):
    """Without the colours of bands, whose weights are detached on purpose: their derivative is not autograd's."""
    torch.manual_seed(1)
    encoder = PhotoEncoder(whole_settings(colour_bands=0)).double()
    torch.nn.init.normal_(encoder.unet.up_2.weight)  # as at the start the mask would be flat
    assert checked(_Masked(encoder, masked), randn(3, 13, 10).sigmoid())


class _Masked(torch.nn.Module):
    def __init__(self, encoder: PhotoEncoder, masked: bool):
        super().__init__()
        self.encoder, self.masked = encoder, masked

    def forward(self, photo):
        return self.encoder(photo, self.masked)


def test_attention_and_masks_pass_gradcheck():
    torch.manual_seed(1)
    assert checked(ChannelAttention(8).double(), randn(1, 8, 3, 5))
    assert checked(MaskUNet(8).double(), randn(1, 8, 5, 7))
    table = MaskTable(2).double()
    parameters = list(table.parameters())
    assert torch.autograd.gradcheck(lambda *_: table(1, 3, 4), parameters, **CHECK)


def test_exposure_and_positional_encoding_pass_gradcheck():
    torch.manual_seed(1)
    transfer = ExposureTransfer(whole_settings()).double()
    torch.nn.init.normal_(transfer.map.weight)
    assert checked(_Exposure(transfer), randn(5, 4, 3), randn(16))
    assert checked(lambda values: encode(values, 4), randn(5, 3))


class _Exposure(torch.nn.Module):
    def __init__(self, transfer: ExposureTransfer):
        super().__init__()
        self.transfer = transfer

    def forward(self, sh, embedding):
        return self.transfer(TransferInput(sh, sh[:, 0]), embedding)
