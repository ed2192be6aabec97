"""Rasterizers: one contract, several backends. To add one: core/README.md, "Add a rasterizer".

what all must do  contract; inputs, what kernels check; layout, what they keep; view, a camera as numbers
the backends      reference, the definition; cpu; cuda
of many views     importance
of many looks     shares
"""

from importlib import import_module

from core.errors import BadSetting
from core.rasterizer.contract import BLACK, Colour, Rasterizer, Visible
from core.setting import AUTO

# Imported only when asked for: Numba and Triton are slow to load.
BACKENDS = {
    "reference": "core.rasterizer.reference:ReferenceRasterizer",
    "cpu": "core.rasterizer.cpu.backend:CpuRasterizer",
    "cuda": "core.rasterizer.cuda.backend:CudaRasterizer",
}
ON_GPU = ("cuda",)  # take tensors on a GPU only; all others take them on a CPU


def create(name: str, device: str = "cpu") -> Rasterizer:
    """The backend `name`, a key of BACKENDS or `auto` (the one named like the device),
    for tensors on a "cpu" or "cuda" `device`.

    Raises BadSetting for another name, another device, and for a backend that lacks what it needs on this machine.
    """
    name = device if name == AUTO else name
    if name not in BACKENDS:
        raise BadSetting(f"There is no backend {name!r}.", f"Choose one of: {', '.join(BACKENDS)}.")
    module, attribute = BACKENDS[name].split(":")
    try:
        backend = getattr(import_module(module), attribute)()
    except ModuleNotFoundError as missing:
        if missing.name != "triton":
            raise
        raise BadSetting(
            "The cuda rasterizer needs Triton, which is not installed.",
            "Install torch's CUDA build, which brings it (Linux), or leave --backend out.",
        ) from None
    if backend.device not in ("any", device):
        raise BadSetting(f"backend={name} does not compute on device={device}.", "Leave --backend out.")
    return backend


__all__ = ["BACKENDS", "BLACK", "ON_GPU", "Colour", "Rasterizer", "Visible", "create"]
