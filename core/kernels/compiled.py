"""How Numba compiles our kernels, which Python calls, and their parts, which only kernels and other parts call.

On its own Numba makes every function ready to be called from Python, from C and from compiled code. These wrappers are
a quarter of the time that a new user waits for the kernels, so kernels get none for C and parts none at all: calling a
part from Python crashes.

Parts become a piece of each kernel that calls them. A part with code of its own would be called by a kernel that was
just compiled, but not by one from the cache, which brings its own copy; and two copies need not round alike.

`exact_` ones round after every operation, as written. In the others a product and a sum may become one instruction,
which rounds once; anything more would let LLVM assume that no NaN comes by.

On its own Numba keeps a kernel on disk until its file changes. Ours are kept until anything changes that they are made
of (core.kernels.made_of), which may lie in other files.
"""

import gc
from collections.abc import Callable
from contextlib import AbstractContextManager

from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache

from core.errors import DiskFull, as_disk_full
from core.kernels.made_of import content, made_of
from core.report import Report

_CONTRACTING = {"fastmath": {"contract"}}
_KERNEL = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_PART = {"forceinline": True, "error_model": "numpy", "no_cfunc_wrapper": True, "no_cpython_wrapper": True}


class _Cache(FunctionCache):
    """Numba's, which knows what a kernel is made of, and says where it found no room."""

    def _index_key(self, sig, codegen):
        return *super()._index_key(sig, codegen), made_of(self._py_func)

    def save_overload(self, sig, data):
        try:
            super().save_overload(sig, data)
        except OSError as problem:
            if as_disk_full(problem) is None:
                raise
            fix = "Free some space, or set NUMBA_CACHE_DIR to a folder on another disk."
            raise DiskFull(f"The disk is full: compiled kernels could not be kept in {self.cache_path}.", fix) from None


def _as_imported(compiled: Callable) -> Callable:
    """The decorator `compiled`, which also reads the function's file: later on it may differ from what was imported."""

    def decorated(function):
        content(function.__code__.co_filename)
        return compiled(function)

    return decorated


def _kept(compiled: Callable) -> Callable:
    """The decorator `compiled`, of a kernel that is kept on disk, as with cache=True."""

    def decorated(function):
        dispatcher = compiled(function)
        dispatcher._cache = _Cache(function)
        return dispatcher

    return decorated


exact_kernel, kernel = (_kept(_as_imported(njit(**_KERNEL, **more))) for more in ({}, _CONTRACTING))
exact_part, part = (_as_imported(njit(**_PART, **more)) for more in ({}, _CONTRACTING))


class _WithoutCollections(event.Listener):
    """Holds Python's garbage collector while a kernel and its parts are compiled.

    A compiler's million objects are mostly in use: to look through them, and torch's, again and again took a seventh of
    the time. Numba compiles under a lock, so nothing races here.
    """

    depth = 0  # of parts in parts in a kernel
    enabled = True

    def on_start(self, _):
        if not self.depth:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, _):
        self.depth -= 1
        if not self.depth and self.enabled:
            gc.enable()


event.register("numba:compile", _WithoutCollections())


class _First(event.Listener):
    """Makes one call when it first hears something."""

    def __init__(self, call: Callable[[], None]):
        self.call = call
        self.is_made = False

    def on_start(self, _):
        if not self.is_made:
            self.is_made = True
            self.call()

    def on_end(self, _):
        pass


def at_first_compilation(call: Callable[[], None]) -> AbstractContextManager:
    """A block that makes this call, once, as soon as a kernel is compiled in it, not loaded from the cache."""
    return event.install_listener("numba:compile", _First(call))


def compiling_told(report: Report) -> AbstractContextManager:
    """A block that tells `report` if kernels are compiled in it: nothing else is heard until they are."""
    return at_first_compilation(lambda: report.say("Compiling the kernels, the first time only: some 15 s"))
