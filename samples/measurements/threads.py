"""Two threads against one: they take turns at the same work,
so that whatever else the machine does affects both alike."""

import math
from collections.abc import Callable

import torch

from core import rasterizer
from samples.measurements.drawing import draw, garden_of
from samples.measurements.scenes import STEP_SIZE_PX, USUAL_SIZE_PX
from samples.measurements.steps import EVERYTHING, WARM_UP, trainer_of
from samples.measurements.stopwatch import WALL, Stopwatch, spread

TURNS = 25
WAYS = {"1 thread": 1, "2 threads": 2}
ONE, TWO = WAYS


def measure_threads(scale: float) -> dict:
    """The garden's picture and gradients, and whole steps of two sizes with everything on;
    speed-ups are of wall time."""
    scene, camera = garden_of(scale)
    backend = rasterizer.create("cpu")
    works: dict[str, Callable[[], object]] = {"rasterizer": lambda: draw(backend, scene, camera)}
    for size_px in (STEP_SIZE_PX, USUAL_SIZE_PX):
        trainer = trainer_of(scale, EVERYTHING, size_px)
        for _ in range(math.ceil(WARM_UP * scale)):
            trainer.step()
        works["step of {} x {}".format(*size_px)] = trainer.step
    parts: dict[str, dict] = {}
    facts: dict[str, float] = {}
    for name, work in works.items():
        measured = in_turns(work, math.ceil(TURNS * scale))
        parts |= {f"{name}, {way}": figures for way, figures in measured.items()}
        facts[name] = round(measured[ONE]["median"][WALL] / measured[TWO]["median"][WALL], 2)
    return {"parts": parts, "facts": facts}


def in_turns(work: Callable[[], object], turns: int) -> dict[str, dict]:
    """The `spread` of the work's seconds for each of WAYS."""
    runs: dict[str, list] = {way: [] for way in WAYS}
    before = torch.get_num_threads()
    for _ in range(1 + turns):
        for way, threads in WAYS.items():
            torch.set_num_threads(threads)
            runs[way].append(Stopwatch().repeat(work, 2, 1)["whole"]["median"])
    torch.set_num_threads(before)
    return {way: spread(spent[1:]) for way, spent in runs.items()}
