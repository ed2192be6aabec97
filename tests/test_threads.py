"""Blocks on threads: every row once, exceptions come out, torch's own setting is put back."""

import pytest
import torch

from core.threads import in_parallel, one_torch_thread


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

    def work(begin: int, end: int) -> None:
        seen[begin:end] += 1
        inside.append((torch.get_num_threads(), torch.is_grad_enabled()))

    in_parallel(work, rows, 8)
    assert (seen == 1).all()
    assert set(inside) <= {(1, False)}
    assert len(inside) == -(-rows // 8)
    assert torch.get_num_threads() == threads


def test_exceptions_come_out_and_the_setting_is_put_back(threads):
    def work(begin: int, end: int) -> None:
        if begin >= 40:
            raise ArithmeticError(f"row {begin}")

    with pytest.raises(ArithmeticError, match="row"):
        in_parallel(work, 100, 8)
    assert torch.get_num_threads() == threads
    with pytest.raises(KeyError), one_torch_thread():
        assert torch.get_num_threads() == 1
        raise KeyError
    assert torch.get_num_threads() == threads
