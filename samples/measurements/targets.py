"""The engine's targets, and what was measured."""

from typing import NamedTuple

from core.words import counted
from samples.measurements.stopwatch import CPU

HEADER = ("what", "target", "measured")
OPENSPLAT_CPU_S = 0.87  # OpenSplat 1.2, blending alone, of a picture like the garden's, on another machine of this kind
ENGINE = ("rasterizer forward", "rasterizer backward", "SH transfer forward", "SH transfer backward")
NOT_KERNELS = ("everything else", "mask, regularisers", "encoder forward")  # of a step without looks


class Line(NamedTuple):
    """What was measured, its target (empty where it has none), and what was found, in words."""

    what: str
    target: str
    found: str


def lines(measurements: dict[str, dict]) -> list[Line]:
    """A line for each measurement that has a target."""
    return [line(measurements[name]) for name, line in LINES if name in measurements]


def _cpu(measured: dict, part: str = "whole") -> float:
    return measured["parts"][part]["median"][CPU]


def _rasterizer(measured: dict) -> Line:
    seconds = _cpu(measured)
    what = (
        f"rasterizer, forward + backward, {measured['facts']['gaussians']:,} Gaussians, {measured['facts']['size_px']}"
    )
    return Line(
        what,
        f"{OPENSPLAT_CPU_S / 8:.3f} CPU-s",
        f"{seconds:.3f} CPU-s, {OPENSPLAT_CPU_S / seconds:.1f}x below {OPENSPLAT_CPU_S}",
    )


def _plain_torch(measured: dict) -> Line:
    facts = measured["facts"]
    errors = f"picture within {facts['picture_error']}, gradients within {facts['gradient_error']}"
    found = (
        f"{facts['times']:.0f}x: {_cpu(measured, 'cpu'):.3f} against "
        f"{_cpu(measured, 'plain torch'):.1f} CPU-s; {errors}"
    )
    return Line("the same against plain torch", "100x", found)


def _step(measured: dict) -> Line:
    parts = measured["parts"]
    others = {part: _cpu(measured, part) for part in parts if part not in ("whole", *ENGINE)}
    largest = max(others, key=others.__getitem__)
    share = others[largest] / _cpu(measured)
    facts = measured["facts"]
    found = (
        f"{1e-3 * facts['cpu_ms']:.3f} CPU-s, "
        f"{1e-3 * facts['wall_ms']:.3f} s wall on {counted(facts['threads'], 'thread')}; "
    )
    found += f"the largest other part is {largest}, {share:.0%}"
    return Line("a step with everything on", "0.10 CPU-s, no part but rasterizer and SH transfer above 10 %", found)


def _plain_step(measured: dict) -> Line:
    others = sum(_cpu(measured, part) for part in NOT_KERNELS)
    ratio = _cpu(measured) / (_cpu(measured) - others)
    return Line("a step without looks and masks", "1.10 x its kernels", f"{ratio:.2f} x, {_cpu(measured):.3f} CPU-s")


def _growth(measured: dict, what: str) -> Line:
    facts = measured["facts"]
    found = (
        f"exponent {facts['exponent']:.2f}, larger half {facts['exponent_of_larger']:.2f}; "
        f"{facts['bytes_a_' + what[:-1]]} bytes a {what[:-1]}"
    )
    return Line(f"growth of the rasterizer in {what}", "exponent 1", found)


def _threads(measured: dict) -> Line:
    found = [f"{what} {times:.2f}x" for what, times in measured["facts"].items()]
    return Line("two threads against one, wall time", "1.8x", "; ".join(found))


def _bake(measured: dict) -> Line:
    facts = measured["facts"]
    found = f"{facts['times_the_products']:.2f} x: {_cpu(measured, 'bake'):.2f} CPU-s (width {facts['transfer_width']})"
    return Line(f"bake of {facts['gaussians']:,} Gaussians", "1.3 x its matrix products", found)


def _first_use(measured: dict) -> Line:
    facts = measured["facts"]
    found = f"{facts['compiling_s']:.0f} s, then {facts['kernels_from_cache_s']:.2f} s"
    return Line("kernels compiled once, then loaded", "20 s, then 1 s", found)


LINES = [
    ("rasterizer", _rasterizer),
    ("plain-torch", _plain_torch),
    ("step", _step),
    ("plain-step", _plain_step),
    ("gaussians", lambda measured: _growth(measured, "gaussians")),
    ("pixels", lambda measured: _growth(measured, "pixels")),
    ("threads", _threads),
    ("bake", _bake),
    ("first-use", _first_use),
]
