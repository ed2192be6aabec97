"""Where to compute: what the setting `device` means on this machine."""

from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from subprocess import SubprocessError

import numpy as np
import torch
from torch import Tensor

from core.errors import BadSetting
from core.setting import AUTO

CPU = torch.device("cpu")


def chosen(device: str, backend: str) -> torch.device:
    """The device that the settings `device` and `backend` stand for.

    `auto` is the GPU if one can be used, unless the backend is `cpu`. If it is a GPU, torch's convolutions compute in
    full float32 from then on. Raises BadSetting for `cuda` if no GPU can be used.
    """
    if device == "cuda":
        if not torch.cuda.is_available():
            raise BadSetting(
                "device=cuda: torch finds no NVIDIA GPU here.",
                "Leave --device out, or install torch's CUDA build and a driver.",
            )
        if fault := fault_of_gpu():
            raise BadSetting(f"device=cuda: {fault}.", "Mend that, or leave --device out.")
    elif not (may_be_gpu(device, backend) and can_use_gpu()):
        return CPU
    # Otherwise cuDNN rounds inputs to 10 bits (TF32), too coarse for SSIM, whose variances are small differences of
    # large sums.
    torch.backends.cudnn.allow_tf32 = False
    return torch.device("cuda", torch.cuda.current_device())


def may_be_gpu(device: str, backend: str) -> bool:
    """Whether these settings let the machine decide to compute on a GPU."""
    return device == AUTO and backend != "cpu"


def can_use_gpu() -> bool:
    """Whether there is a GPU that wegs can use."""
    return torch.cuda.is_available() and fault_of_gpu() is None


def fault_of_gpu() -> str | None:
    """Why the GPU cannot be used, and what to do about it; None if it can, or if torch finds none."""
    if not torch.cuda.is_available():
        return None
    if find_spec("triton") is None:  # on Windows torch comes without
        return "Triton, which its kernels are written in, is not installed"
    return _fault_of_first_use()


@cache
def _fault_of_first_use() -> str | None:
    """What goes wrong when torch and Triton are first used on the GPU, which no version number tells beforehand."""
    try:
        torch.ones(2, device="cuda").sum().item()  # torch also finds GPUs that its build no longer supports
    except torch.OutOfMemoryError:
        raise
    except RuntimeError as problem:
        return (
            f"torch cannot compute on this GPU ({first_line(problem)}), "
            "which may be too old for this build of torch, or in use"
        )
    try:
        from triton.runtime import driver  # only where there is a GPU

        _ = driver.active.utils  # compiled in C, for this Python
    except (RuntimeError, AssertionError, ImportError, OSError, SubprocessError) as problem:
        return _fault_without_compiler(first_line(problem))
    return None


def _fault_without_compiler(reason: str) -> str | None:
    """What goes wrong when Triton's kernels are launched without what it could not compile, for this reason."""
    try:
        from core.system import triton_driver

        triton_driver.install()
    except torch.OutOfMemoryError:
        raise
    except Exception as problem:  # noqa: BLE001 - whatever a Triton does that we do not know
        needed = (
            "a cache that may be written (TRITON_CACHE_DIR) and, it seems, a C compiler and Python's headers "
            "(on Debian: apt install gcc python3-dev)"
        )
        return f"Triton cannot be used here ({reason}; without that: {first_line(problem)}); it needs {needed}"
    return None


def first_line(problem: Exception) -> str:
    """What torch, CUDA or Triton say is wrong, at most 120 characters of it, without their advice to programmers."""
    return next(iter(str(problem).splitlines()), type(problem).__name__)[:120].rstrip(". ")


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """A small tensor of the host on `device`: itself if that is the host, else a copy that nobody waits for,
    as from pinned memory it only joins the GPU's queue."""
    return (tensor.pin_memory() if device.type == "cuda" else tensor).to(device, non_blocking=True)


def sent_together(tensors: Sequence[Tensor], device: torch.device) -> list[Tensor]:
    """As `sent`, for several tensors of one type, in a single copy."""
    flat = sent(torch.cat([tensor.flatten() for tensor in tensors]), device)
    return [part.view_as(tensor) for part, tensor in zip(flat.split([tensor.numel() for tensor in tensors]), tensors)]


def array_of(tensor: Tensor) -> np.ndarray:
    """A tensor on the host as the kernels take it: its own memory where that is contiguous, else a copy."""
    return tensor.detach().contiguous().numpy()


def of_run(trained_on: str) -> torch.device:
    """Where to use a run whose setting `device` is `trained_on`:
    on the GPU if it was trained on one and there is one here."""
    return chosen(AUTO if trained_on == "cuda" else "cpu", AUTO)


def named(device: torch.device) -> str:
    """The device in words."""
    return f"the GPU ({torch.cuda.get_device_name(device)})" if device.type == "cuda" else "the CPU"
