"""Blocks on threads: every row once, exceptions come out, torch's own setting is put back."""

import pytest
import torch

from core.appearance.threads import for_each_block, one_torch_thread


@pytest.fixture(params=[1, 2, 4])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.mark.parametrize("rows", [0, 1, 7, 8, 9, 100])
def test_every_row_exactly_once(threads, rows):
    seen = torch.zeros(rows, dtype=torch.int64)
    inside = []

    def work(block: slice) -> None:
        seen[block] += 1
        inside.append((torch.get_num_threads(), torch.is_grad_enabled()))

    for_each_block(work, rows, 8)
    assert (seen == 1).all()
    assert set(inside) <= {(1, False)}
    assert len(inside) == -(-rows // 8)
    assert torch.get_num_threads() == threads


def test_exceptions_come_out_and_the_setting_is_put_back(threads):
    def work(block: slice) -> None:
        if block.start >= 40:
            raise ArithmeticError(f"row {block.start}")

    with pytest.raises(ArithmeticError, match="row"):
        for_each_block(work, 100, 8)
    assert torch.get_num_threads() == threads
    with pytest.raises(KeyError), one_torch_thread():
        assert torch.get_num_threads() == 1
        raise KeyError
    assert torch.get_num_threads() == threads
