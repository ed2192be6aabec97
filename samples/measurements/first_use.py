"""How long a new user waits: for the kernels to be compiled, once, and for the first step of every later run."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCALE = 0.1  # of a step's scene: a new user's wait should not be the photos'


def measure_first_use(scale: float) -> dict:
    """A fresh process up to its second step, first with an empty Numba cache and then with the cache that it left."""
    with tempfile.TemporaryDirectory() as cache:
        cold, warm = start(Path(cache)), start(Path(cache))
    compiling = sum(cold.values()) - sum(warm.values())
    rows = [[part, round(cold[part], 2), round(warm[part], 2)] for part in cold]
    rows.append(["whole", round(sum(cold.values()), 2), round(sum(warm.values()), 2)])
    facts = {
        "compiling_s": round(compiling, 1),
        "kernels_from_cache_s": round(warm["first step"] - warm["second step"], 2),
    }
    return {"parts": {}, "facts": facts, "series": {"columns": ["wall s", "empty cache", "from cache"], "rows": rows}}


def start(cache: Path | None = None) -> dict[str, float]:
    """Wall seconds by part of a fresh process that uses this Numba cache, or else the user's own."""
    command = [sys.executable, __file__, str(time.monotonic())]
    environment = os.environ | ({"NUMBA_CACHE_DIR": str(cache)} if cache else {})
    return json.loads(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)


def first_step(started: float) -> dict[str, float]:
    """Wall seconds by part of this process. started: time.monotonic() of the parent when it started this process."""
    laps, last = {}, started

    def lap(part: str) -> None:
        nonlocal last
        now = time.monotonic()
        laps[part], last = now - last, now

    sys.path.insert(0, str(Path(__file__).parents[2]))
    from core.system.process import prepare

    prepare()
    import torch  # noqa: F401

    lap("Python and torch")
    from core.training.compiling import compile_kernels
    from samples.measurements.steps import EVERYTHING, trainer_of

    lap("wegs")
    trainer = trainer_of(SCALE, EVERYTHING)
    lap("photos")
    compile_kernels(looks=True)
    trainer.step()
    lap("first step")
    trainer.step()
    lap("second step")
    return laps


if __name__ == "__main__":
    print(json.dumps(first_step(float(sys.argv[1]))))
