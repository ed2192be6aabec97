"""CPU and wall time by part, and the most memory held."""

import resource
import sys
import time
from pathlib import Path

import numpy as np

CPU, WALL = 0, 1  # of a pair of seconds
STATUS, FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Stopwatch:
    """Adds the time since the last lap to the part named at its end. laps: part -> [CPU s, wall s]."""

    def start(self) -> None:
        self.laps: dict[str, np.ndarray] = {}
        self.last = now()

    def lap(self, part: str) -> None:
        at = now()
        self.laps[part] = self.laps.get(part, 0) + at - self.last
        self.last = at

    def repeat(self, work, warm_up: int, times: int) -> dict:
        """Call work(), `warm_up` times unmeasured and then `times` measured: part -> its `spread`."""
        runs = []
        for _ in range(warm_up + times):
            self.start()
            work()
            self.lap("everything else")
            runs.append({"whole": sum(self.laps.values(), np.zeros(2))} | self.laps)
        return {part: spread([run[part] for run in runs[warm_up:]]) for part in runs[-1]}


def now() -> np.ndarray:
    """CPU and wall time, in seconds."""
    return np.array([time.process_time(), time.perf_counter()])


def spread(laps: list) -> dict:
    """Median, quartiles (low, high) and mean of laps, each as [CPU s, wall s]."""
    low, median, high = np.quantile(laps, (0.25, 0.5, 0.75), axis=0).tolist()
    return {"median": median, "low": low, "high": high, "mean": np.mean(laps, axis=0).tolist()}


def forget_peak() -> None:
    """Let `peak_memory` start afresh, where the system can do that."""
    try:
        FORGET_PEAK.write_text("5")
    except OSError:
        pass  # not Linux: the peak is the process's, and sizes are measured in ascending order


def peak_memory() -> int:
    """The most bytes this process has held in memory since `forget_peak`, or ever."""
    try:
        lines = STATUS.read_text().splitlines()
    except OSError:
        lines = []
    for line in lines:
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
