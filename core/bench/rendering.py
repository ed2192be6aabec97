"""Rendering: the error of a picture over the time it takes,
for every backend and everything that the definition can trade.

Error is measured twice. Against the definition in float64, with the contract's thresholds, because that is the picture
which every 3DGS viewer shows; and against the sum without thresholds, because that is what the thresholds themselves
approximate. Pictures are over black, linear in [0, 1].
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

import core.rasterizer
from core.bench.differences import HALF_STEP_LINE, differences
from core.bench.figure import Figure, Panel, Point, Quantity, Spread
from core.bench.levers import UNTHRESHOLDED, Levers, draw
from core.bench.machine import made_on
from core.bench.stopwatch import timed
from core.rasterizer.contract import ALPHA_MIN, STOP_TRANSMITTANCE
from core.report import Report
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.words import counted

QUANTITIES = (
    Quantity("milliseconds", "ms a picture", "log"),
    Quantity("max_error", "max error", "log", limit=HALF_STEP_LINE, floor=1e-9),
    Quantity("rms_error", "RMS error", "log", limit=HALF_STEP_LINE, floor=1e-9),
    Quantity("rms_unthresholded", "RMS error against no thresholds", "log", limit=HALF_STEP_LINE),
)
PANELS = tuple(Panel("milliseconds", quantity.name) for quantity in QUANTITIES[1:])
NOTES = (
    "Errors are against the float64 reference with the contract's thresholds, and against the sum without any.",
    "`reference`: the definition blended tile by tile. Other backends have the contract's thresholds compiled in.",
)
ALPHAS = {"1/1020": 0.25, "1/255": 1.0, "4/255": 4.0, "16/255": 16.0}  # times ALPHA_MIN
STOPS = (1e-6, STOP_TRANSMITTANCE, 1e-3, 1e-2)
TILES_PX = (8, 16, 32, 64)
DEFINITION = "reference"
MOST_PAIRS = 50_000_000  # of a pixel and a Gaussian: what the backend `reference`, which looks at all, does in seconds


@dataclass(frozen=True)
class Way:
    """One way to draw. backend: a key of BACKENDS, whose one lever is the SH degree,
    or None for the definition tile by tile."""

    backend: str | None
    levers: Levers

    def draw(self, splats: Splats, cameras: list[Camera], budget: float) -> tuple[list[Tensor], Spread]:
        """The pictures, and the seconds that all of them take. splats: float32. budget: see `stopwatch.timed`."""
        levers = self.levers
        if self.backend is None:
            return timed(lambda: [draw(splats, camera, levers) for camera in cameras], budget)
        shown = splats.up_to_degree(levers.sh_degree)
        rasterizer = core.rasterizer.create(self.backend)
        if self.backend == DEFINITION:
            shown = shown.map(torch.Tensor.double)
        else:
            rasterizer.render(shown, cameras[0])  # compiles, for seconds that no repeat may count
        return timed(lambda: [rasterizer.render(shown, camera) for camera in cameras], budget)


@dataclass(frozen=True)
class Choice:
    """A point to be measured: its curve, a word for the choice on it, and the way to draw."""

    curve: str
    label: str
    way: Way
    is_default: bool = False


@torch.no_grad()
def rendering_figure(
    what: str,
    splats: Splats,
    cameras: list[Camera],
    report: Report,
    *,
    seed: int,
    budget: float,
    name: str = "rendering",
) -> Figure:
    """All CPU backends and levers, on splats (float32) and cameras. what: these, in words.
    budget: see `stopwatch.timed`. name: the figure's."""
    exact = [draw(splats, camera, Levers(sh_degree=splats.degree)) for camera in cameras]
    unthresholded = [draw(splats, camera, UNTHRESHOLDED) for camera in cameras]
    chosen = list(choices(splats, cameras))
    measured: dict[Way, dict[str, Spread]] = {}  # a way that lies on several curves is measured once
    points = []
    for number, choice in enumerate(chosen):
        if choice.way not in measured:
            pictures, seconds = choice.way.draw(splats, cameras, budget)
            values = {"milliseconds": seconds.scaled(1000 / len(cameras)), **differences(pictures, exact)}
            values["rms_unthresholded"] = differences(pictures, unthresholded)["rms_error"]
            measured[choice.way] = values
        points.append(Point(choice.curve, choice.label, measured[choice.way], choice.is_default))
        report.progress("Rendering", number + 1, len(chosen), f"{choice.curve}: {choice.label}")
    title = (
        f"Rendering {what}: {counted(len(splats), 'Gaussian')} of degree {splats.degree}, "
        f"{cameras[0].width} x {cameras[0].height} px"
    )
    return Figure(name, title, QUANTITIES, PANELS, tuple(points), made_on(seed), NOTES)


def choices(splats: Splats, cameras: list[Camera]) -> Iterator[Choice]:
    """The definition with precision, tiles, thresholds and SH degree varied one at a time;
    each other CPU backend with the SH degree varied."""
    plain = Levers(sh_degree=splats.degree)
    degrees = {f"degree {degree}": replace(plain, sh_degree=degree) for degree in range(splats.degree + 1)}
    curves = {
        "precision": {"float64": plain, "float32": replace(plain, dtype=torch.float32)},
        "tile": {f"{side} px": replace(plain, tile_px=side) for side in TILES_PX},
        "alpha threshold": {
            f"alpha {label}": replace(plain, alpha_min=share * ALPHA_MIN) for label, share in ALPHAS.items()
        },
        "early stop": {f"stop {stop:g}": replace(plain, stop_transmittance=stop) for stop in STOPS},
        "SH degree": degrees,
    }
    for curve, found in curves.items():
        for label, levers in found.items():
            yield Choice(f"{DEFINITION}: {curve}", label, Way(None, levers))
        if curve == "tile" and len(splats) * max(camera.width * camera.height for camera in cameras) <= MOST_PAIRS:
            yield Choice(f"{DEFINITION}: {curve}", "no tiles", Way(DEFINITION, plain))
    for backend in core.rasterizer.BACKENDS:
        if backend != DEFINITION and backend not in core.rasterizer.ON_GPU:
            for label, levers in degrees.items():
                is_default = backend == "cpu" and levers == plain  # what `auto` stands for on a CPU
                yield Choice(f"{backend}: SH degree", label, Way(backend, levers), is_default)
