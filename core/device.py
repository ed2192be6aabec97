"""Where to compute: what the setting `device` means on this machine."""

from importlib.util import find_spec

import torch

from core.config import AUTO
from core.errors import BadSetting

CPU = torch.device("cpu")


def chosen(device: str, backend: str) -> torch.device:
    """The device that the settings `device` and `backend` stand for.

    `auto` is the GPU where one can be used, unless a backend of the CPU was asked for. Raises BadSetting for `cuda` without one.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise BadSetting(
            "device=cuda: torch finds no NVIDIA GPU here.", "Leave --device out, or install torch's CUDA build and a driver."
        )
    on_gpu = device == "cuda" or (device == AUTO and backend != "cpu" and can_use_gpu())
    return torch.device("cuda", torch.cuda.current_device()) if on_gpu else CPU


def can_use_gpu() -> bool:
    """Whether there is a GPU, and Triton, which its kernels are written in (on Windows torch comes without)."""
    return torch.cuda.is_available() and find_spec("triton") is not None


def of_run(trained_on: str) -> torch.device:
    """Where to use a run whose setting `device` is `trained_on`: on the GPU if it was trained on one and there is one here."""
    return chosen(AUTO if trained_on == "cuda" else "cpu", AUTO)


def named(device: torch.device) -> str:
    """The device in words."""
    return f"the GPU ({torch.cuda.get_device_name(device)})" if device.type == "cuda" else "the CPU"
