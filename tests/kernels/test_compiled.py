"""How kernels are compiled: what it must not leave behind."""

import gc

import pytest
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.errors import TypingError

from core.errors import DiskFull
from core.kernels.compiled import compiling_told, exact_kernel, exact_part
from tests.failing import DISK_FULL, failing
from tests.heard import Heard


class Watch(event.Listener):
    def __init__(self):
        self.collecting = []

    def on_start(self, _):
        self.collecting.append(gc.isenabled())

    def on_end(self, _):
        pass


@exact_part
def doubled(x):
    return x + x


def test_the_collector_rests_while_kernel_and_parts_are_compiled():
    def quadrupled(x):
        return doubled(doubled(x))

    watch = Watch()
    event.register("numba:compile", watch)
    try:
        assert njit(quadrupled)(1.5) == 6  # of ours a kernel would come from the cache the next time
    finally:
        event.unregister("numba:compile", watch)
    assert watch.collecting == [False, False]
    assert gc.isenabled()


def test_the_collector_is_back_after_a_kernel_that_cannot_be_compiled():
    def impossible(x):
        return x.nothing

    with pytest.raises(TypingError):
        exact_kernel(impossible)(1.5)
    assert gc.isenabled()


def test_a_disk_without_room_for_a_kernel_is_named(monkeypatch):
    def fourthed(x):
        return x / 4

    monkeypatch.setattr(FunctionCache, "save_overload", failing(DISK_FULL))
    with pytest.raises(DiskFull, match="could not be kept in .*kernels.* or set NUMBA_CACHE_DIR"):
        exact_kernel(fourthed)(1.0)


def test_compiling_is_announced_once_and_not_for_cached_kernels():
    def halved(x):
        return x / 2

    def thirded(x):
        return x / 3

    kernels = njit(halved), njit(thirded)
    for lines in (["Compiling the kernels, the first time only: some 15 s"], []):
        heard = Heard()
        with compiling_told(heard):
            assert [kernel(6.0) for kernel in kernels] == [3, 2]
        assert heard.lines == lines
