"""One thread against two: the same work in turns, so that whatever else the machine does meets both; cores kept awake as in training."""

import math
import os
from collections.abc import Callable

import torch

from core import rasterizer
from core.awake import cores_awake
from samples.measurements.drawing import draw, garden_of
from samples.measurements.steps import WARM_UP, trainer_of
from samples.measurements.stopwatch import Stopwatch, spread

TURNS = 25
THREADS = 1, 2


def measure_threads(scale: float) -> dict:
    """Picture and gradients of the garden, and whole steps with everything on; speed-ups are of the wall time."""
    scene, camera = garden_of(scale)
    backend, trainer = rasterizer.create("cpu"), trainer_of(scale, "full", "on")
    for _ in range(math.ceil(WARM_UP * scale)):
        trainer.step()
    parts, facts = {}, {"cores": os.cpu_count()}
    for name, work in (("rasterizer", lambda: draw(backend, scene, camera)), ("step", trainer.step)):
        measured = in_turns(work, math.ceil(TURNS * scale))
        parts |= {f"{name}, {threads} thread{'s' * (threads > 1)}": measured[threads] for threads in THREADS}
        facts[f"{name}_speed_up"] = round(measured[1]["median"][1] / measured[2]["median"][1], 2)
    return {"parts": parts, "facts": facts}


def in_turns(work: Callable[[], object], turns: int) -> dict[int, dict]:
    """Figures as of `Stopwatch.repeat` for each number of threads."""
    runs = {threads: [] for threads in THREADS}
    before = torch.get_num_threads()
    for _ in range(1 + turns):
        for threads in THREADS:
            torch.set_num_threads(threads)
            with cores_awake():
                runs[threads].append(Stopwatch().repeat(work, 0, 1)["whole"]["median"])
    torch.set_num_threads(before)
    return {threads: spread(spent[1:]) for threads, spent in runs.items()}
