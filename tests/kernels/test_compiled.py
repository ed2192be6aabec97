"""How kernels are compiled: what it must not leave behind."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.errors import TypingError

import core
from core.appearance.transfer_kernels import mlp_forward
from core.errors import DiskFull
from core.kernels.compiled import compiling_told, exact_kernel, exact_part
from core.kernels.made_of import made_of
from core.rasterizer import layout
from core.rasterizer.cpu.blend_forward import blend_forward
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


KERNEL_OF_THREE_FILES = {
    "constant.py": "OFFSET = 1",
    "part.py": """
from core.kernels.compiled import exact_part
from constant import OFFSET

@exact_part
def moved(x):
    return x + OFFSET
""",
    "kernel.py": """
from core.kernels.compiled import exact_kernel
from part import moved

@exact_kernel
def moved_twice(x):
    return max([moved(moved(x)) for _ in range(2)])  # a function of its own, before Python 3.12

print(moved_twice(10), sum(moved_twice.stats.cache_hits.values()))
""",
}

EDITED_WHILE_IMPORTED = """
from pathlib import Path
Path(__file__).write_text('''
from core.kernels.compiled import exact_part

@exact_part
def moved(x):
    return x + 5.0
''')
"""


def test_a_kernel_is_kept_until_anything_changes_that_it_is_made_of(tmp_path):
    """Each time in a fresh process, with the kernel's own file as it was."""
    for name, text in KERNEL_OF_THREE_FILES.items():
        (tmp_path / name).write_text(text)
    environment = os.environ | {"PYTHONPATH": str(Path(core.__file__).parents[1]), "NUMBA_CACHE_DIR": str(tmp_path)}

    def result_and_hits() -> list[str]:
        command = [sys.executable, str(tmp_path / "kernel.py")]
        return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.split()

    def edit(name: str, old: str, new: str) -> None:
        (tmp_path / name).write_text(KERNEL_OF_THREE_FILES[name].replace(old, new))

    assert [result_and_hits(), result_and_hits()] == [["12", "0"], ["12", "1"]]
    edit("constant.py", "1", "2.5")
    assert [result_and_hits(), result_and_hits()] == [["15.0", "0"], ["15.0", "1"]]
    edit("part.py", "x + OFFSET", "x - OFFSET")
    assert result_and_hits() == ["5.0", "0"]
    # Edited once it is imported: what is compiled then must not pass for what the file says by now.
    (tmp_path / "part.py").write_text(KERNEL_OF_THREE_FILES["part.py"] + EDITED_WHILE_IMPORTED)
    assert [result_and_hits(), result_and_hits()] == [["15.0", "0"], ["20.0", "0"]]


@pytest.mark.parametrize("kernel, also", [(blend_forward, "blend.py"), (mlp_forward, "matrix_product.py")])
def test_intrinsics_and_what_they_call_are_part_of_a_kernel(monkeypatch, kernel, also):
    files = set()
    monkeypatch.setattr("core.kernels.made_of.content", lambda file: files.add(Path(file).name) or b"")
    made_of.__wrapped__(kernel.py_func)
    assert files >= {"compiled.py", "simd.py", also}


def test_constants_of_a_module_are_part_of_a_kernel(monkeypatch):
    before = made_of.__wrapped__(blend_forward.py_func)
    monkeypatch.setattr(layout, "FALL", 5)
    assert made_of.__wrapped__(blend_forward.py_func) != before
