"""Triton's kernels launched without what it compiles in C: the calls are those of its own launcher."""

import json
import subprocess
import sysconfig
from pathlib import Path
from shutil import which
from types import SimpleNamespace

import pytest
import torch

pytest.importorskip("triton")

from triton.backends import nvidia

from core.system.triton_driver import Cuda, Launcher
from tests.programs import run_python


def compiling(program: str, cache: Path, **environment: str) -> str:
    """What a program prints that compiles Triton's kernels."""
    return run_python(program, TRITON_INTERPRET=None, TRITON_CACHE_DIR=str(cache), **environment).stdout


@pytest.mark.skipif(torch.cuda.is_available(), reason="a stand-in for the driver of a GPU that is here")
@pytest.mark.skipif(not which("gcc"), reason="Triton's own launcher takes a C compiler")
@pytest.mark.skipif(
    not Path(sysconfig.get_paths()["include"], "Python.h").exists(),
    reason="Triton's own launcher takes Python's headers",
)
def test_the_driver_is_asked_for_what_tritons_own_launcher_asks_for(tmp_path):
    source = Path(__file__).parent / "cuda_stand_in.c"
    headers = Path(nvidia.__file__).parent / "include"
    library = tmp_path / "libcuda.so.1"
    subprocess.run(["gcc", "-shared", "-fPIC", f"-I{headers}", str(source), "-o", str(library)], check=True)
    program = "from tests.system.launched import tell; tell()"
    found = json.loads(compiling(program, tmp_path / "cache", LD_LIBRARY_PATH=str(tmp_path)))
    assert found["ours"] == found["theirs"]
    assert [log.count("launch") for log in found["ours"]] == [1, 1, 0, 1]  # nothing for an empty grid


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_needs_no_compiler(tmp_path):
    trained = compiling(
        "from pathlib import Path; from core.system import device; "
        "from tests.small import finished, small_collection, small_settings; "
        "from triton.runtime import driver; "
        f"run = finished(small_collection(Path({str(tmp_path)!r})), small_settings(device='cuda'), "
        f"Path({str(tmp_path)!r}, 'run')); "
        "print(run.device.type, type(driver.active).__module__)",
        tmp_path / "cache",
        CC="false",
    )
    assert trained.split() == ["cuda", "core.system.triton_driver"]


def test_a_call_that_fails_is_raised_in_the_drivers_words():
    def words(status, pointer):
        pointer._obj.value = {201: b"invalid device context"}[status]

    cuda = object.__new__(Cuda)
    cuda.library = SimpleNamespace(cuCtxGetCurrent=lambda _: 201, cuGetErrorString=words)
    with pytest.raises(RuntimeError, match="cuCtxGetCurrent: invalid device context"):
        cuda.give_context(0)


@pytest.mark.parametrize(
    "asked", [{"num_ctas": 2}, {"launch_cooperative_grid": True}, {"launch_pdl": True}, {"global_scratch_size": 128}]
)
def test_a_kernel_that_asks_for_more_is_refused(asked):
    flags = dict.fromkeys(("launch_cooperative_grid", "launch_pdl"), False)
    plain = {"name": "blend", "num_ctas": 1, "global_scratch_size": 0, "profile_scratch_size": 0, **flags}
    Launcher(SimpleNamespace(signature={}), SimpleNamespace(**plain))
    with pytest.raises(NotImplementedError, match="blend asks for more than a plain launch"):
        Launcher(SimpleNamespace(signature={}), SimpleNamespace(**{**plain, **asked}))
