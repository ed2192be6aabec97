"""Blocks on threads and work beside: every row once, exceptions come out, nobody waits for a busy thread,
torch's own setting is put back."""

import os
import threading
import time

import pytest
import torch

import core.system.threads
from core.system.threads import beside, in_parallel, mapped_in_parallel, one_torch_thread, threads_for_blocks


@pytest.fixture(params=[1, 2, 4])
def threads(request, many_threads):
    torch.set_num_threads(request.param)
    return request.param


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


@pytest.mark.parametrize("most", [None, 1])
def test_results_stand_in_the_order_of_the_items(threads, most):
    """The first takes longest; with `most` of one, all of them on the calling thread."""
    places, at_work = set(), most or threads
    all_here = threading.Barrier(at_work)

    def square(number: int) -> int:
        if number < at_work:
            all_here.wait(60)
        time.sleep(0.02 if number == 0 else 0.001)
        places.add(threading.get_ident())
        return number**2

    assert mapped_in_parallel(square, range(12), most) == [number**2 for number in range(12)]
    assert len(places) == at_work and threading.get_ident() in places
    assert mapped_in_parallel(square, []) == []


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


@pytest.mark.parametrize("threads", [2], indirect=True)
def test_an_exception_of_another_thread_comes_out(threads):
    raised = threading.Event()

    def work(begin: int, end: int) -> None:
        if threading.current_thread() is threading.main_thread():
            assert raised.wait(60)
        else:
            raised.set()
            raise ArithmeticError("elsewhere")

    with pytest.raises(ArithmeticError, match="elsewhere"):
        in_parallel(work, 2, 1)


@pytest.mark.parametrize("threads", [2], indirect=True)
def test_an_exception_comes_out_when_the_other_threads_have_stopped(threads):
    """They write into arrays of the caller's, which may be gone by then."""
    here, begun, written = threading.Event(), threading.Event(), []

    def work(begin: int, end: int) -> None:
        if threading.current_thread() is threading.main_thread():
            here.set()
            assert begun.wait(60)
            raise ArithmeticError("here")
        assert here.wait(60)  # or this thread might take both
        begun.set()
        time.sleep(0.1)
        written.append(begin)

    with pytest.raises(ArithmeticError, match="here"):
        in_parallel(work, 2, 1)
    assert len(written) == 1


@pytest.mark.parametrize("threads", [2], indirect=True)
@pytest.mark.parametrize("fails", ["the caller", "another thread"])
def test_no_block_is_begun_after_an_exception(threads, fails):
    """Or Ctrl-C would wait until the other threads have decoded all photos, or matched all pairs."""
    both_begun, raised, finished = threading.Barrier(2), threading.Event(), []

    def work(begin: int, end: int) -> None:
        if begin >= 2:
            finished.append(begin)
            return
        both_begun.wait(60)
        if (threading.current_thread() is threading.main_thread()) == (fails == "the caller"):
            raised.set()
            raise KeyboardInterrupt
        assert raised.wait(60)
        time.sleep(1)  # until the other thread has taken what is left

    with pytest.raises(KeyboardInterrupt):
        in_parallel(work, 1000, 1)
    assert finished == []


@pytest.mark.parametrize("with_gradients", [True, False])
def test_beside_gives_the_result_from_one_torch_thread_with_the_callers_gradients(threads, with_gradients):
    started = threading.Event()

    def work():
        started.set()
        return threading.current_thread() is threading.main_thread(), torch.get_num_threads(), torch.is_grad_enabled()

    with torch.set_grad_enabled(with_gradients):
        finish = beside(work)
        assert threads == 1 or started.wait(60)
        assert finish() == (threads == 1, 1, with_gradients)
    assert torch.get_num_threads() == threads


def test_beside_raises_where_the_result_is_asked_for(threads):
    def work():
        raise ArithmeticError("beside")

    finish = beside(work)
    with pytest.raises(ArithmeticError, match="beside"):
        finish()
    assert torch.get_num_threads() == threads


def test_a_busy_thread_is_not_waited_for():
    """Neither by blocks nor by work beside: with every thread of the pool held up, the caller does all of it."""
    torch.set_num_threads(2)
    free, seen = threading.Event(), []
    held = [beside(free.wait) for _ in range(os.cpu_count() or 1)]
    in_parallel(lambda begin, end: seen.append((begin, threading.current_thread())), 40, 8)
    finish = beside(threading.current_thread)
    assert seen == [(begin, threading.main_thread()) for begin in range(0, 40, 8)]
    assert finish() is threading.main_thread()
    free.set()
    assert all(finish() for finish in held)


def test_blocks_keep_the_threads_that_torch_gives_up(threads):
    with threads_for_blocks():
        assert (torch.get_num_threads(), core.system.threads.threads()) == (1, threads)
        with threads_for_blocks():
            assert core.system.threads.threads() == threads
    assert (torch.get_num_threads(), core.system.threads.threads()) == (threads, threads)
