"""Rasterizers: one contract, several backends. Adding one is a module and a line in BACKENDS."""

from importlib import import_module

from core.errors import BadSetting
from core.rasterizer.contract import Rasterizer, Rendering

# Imported only when asked for: Numba and Triton are slow to load.
BACKENDS = {
    "reference": "core.rasterizer.reference:ReferenceRasterizer",
    "cpu": "core.rasterizer.cpu.backend:CpuRasterizer",
}
AUTO = "cpu"  # what `auto` stands for


def create(name: str) -> Rasterizer:
    """The backend called `name`, a key of BACKENDS or `auto`."""
    name = AUTO if name == "auto" else name
    if name not in BACKENDS:
        raise BadSetting(f"There is no backend {name!r}.", f"Choose one of: {', '.join(BACKENDS)}.")
    module, attribute = BACKENDS[name].split(":")
    return getattr(import_module(module), attribute)()


__all__ = ["BACKENDS", "Rasterizer", "Rendering", "create"]
