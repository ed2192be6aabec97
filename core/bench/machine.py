"""The machine that a figure was measured on, without which seconds mean nothing."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch

import core
from core.system.cores import cores

PACKAGES = ("torch", "numba", "numpy")


def made_on(*seeds: int) -> dict[str, str]:
    """Machine, threads, versions and seeds, in words, in the order in which they are shown."""
    facts = {"cpu": cpu_model(), "cores": str(cores()), "threads": str(torch.get_num_threads())}
    if torch.cuda.is_available():
        facts["gpu"] = torch.cuda.get_device_name()
    if hasattr(os, "getloadavg"):  # what else ran, which often explains a wide spread
        facts["load"] = f"{os.getloadavg()[0]:.1f}"
    facts["wegs"] = core.__version__
    facts |= {name: _version(name) for name in PACKAGES}
    if torch.cuda.is_available():
        facts |= {"cuda": str(torch.version.cuda), "triton": _version("triton")}
    return facts | {"python": platform.python_version(), "seed": ", ".join(map(str, seeds))}


def cpu_model() -> str:
    """As the processor calls itself, where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return (names[0] if names else "") or platform.processor() or platform.machine() or "unknown"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
