"""Where to compute: what the setting `device` means on this machine."""

from importlib.util import find_spec

import torch
from torch import Tensor

from core.config import AUTO
from core.errors import BadSetting

CPU = torch.device("cpu")


def chosen(device: str, backend: str) -> torch.device:
    """The device that the settings `device` and `backend` stand for.

    `auto` is the GPU where one can be used, unless a backend of the CPU was asked for. Raises BadSetting for `cuda` without one.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise BadSetting("device=cuda: torch finds no NVIDIA GPU here.", "Leave --device out, or install torch's CUDA build and a driver.")
    if device != "cuda" and (device != AUTO or backend == "cpu" or not can_use_gpu()):
        return CPU
    # Otherwise cuDNN rounds what it convolves to 10 bits (TF32), too coarse for SSIM, whose variances are small differences of such sums.
    torch.backends.cudnn.allow_tf32 = False
    return torch.device("cuda", torch.cuda.current_device())


def can_use_gpu() -> bool:
    """Whether there is a GPU, and Triton, which its kernels are written in (on Windows torch comes without)."""
    return torch.cuda.is_available() and find_spec("triton") is not None


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """A small tensor of the host's copied to `device` without waiting: from pinned memory the copy only joins the GPU's queue."""
    return (tensor.pin_memory() if device.type == "cuda" else tensor).to(device, non_blocking=True)


class OnTheWay:
    """Numbers that a device is still computing, requested without waiting for them; only `arrived` waits, if they have not come by then."""

    def __init__(self, numbers: Tensor):
        self.numbers = numbers.to(CPU, non_blocking=True)  # from a GPU: into pinned memory
        self.event = torch.cuda.current_stream(numbers.device).record_event() if numbers.device.type == "cuda" else None

    def arrived(self) -> list[float]:
        """The numbers, once the device has computed them."""
        if self.event is not None:
            self.event.synchronize()
        return self.numbers.tolist()


def of_run(trained_on: str) -> torch.device:
    """Where to use a run whose setting `device` is `trained_on`: on the GPU if it was trained on one and there is one here."""
    return chosen(AUTO if trained_on == "cuda" else "cpu", AUTO)


def named(device: torch.device) -> str:
    """The device in words."""
    return f"the GPU ({torch.cuda.get_device_name(device)})" if device.type == "cuda" else "the CPU"
