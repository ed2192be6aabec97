"""CPU and wall time by part, and the most memory held."""

import resource
import sys
import time
from pathlib import Path

import numpy as np

STATUS, FORGET_PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Stopwatch:
    """Everything since the last lap goes to the part named at its end. laps: part -> (CPU, wall) seconds."""

    def start(self) -> None:
        self.laps, self.last = {}, np.array([time.process_time(), time.perf_counter()])

    def lap(self, part: str) -> None:
        now = np.array([time.process_time(), time.perf_counter()])
        self.laps[part] = self.laps.get(part, 0) + now - self.last
        self.last = now

    def repeat(self, work, warm_up: int, times: int) -> dict:
        """Call work() often: part -> median, quartiles (low, high) and mean of the last `times`, as [CPU s, wall s]."""
        runs = []
        for _ in range(warm_up + times):
            self.start()
            work()
            self.lap("everything else")
            runs.append({"whole": sum(self.laps.values())} | self.laps)
        return {part: spread([run[part] for run in runs[warm_up:]]) for part in runs[-1]}


def spread(laps: list) -> dict:
    """Median, quartiles (low, high) and mean of laps, each as [CPU s, wall s]."""
    low, median, high = np.quantile(laps, (0.25, 0.5, 0.75), axis=0).tolist()
    return {"median": median, "low": low, "high": high, "mean": np.mean(laps, axis=0).tolist()}


def forget_peak() -> None:
    """Let `peak_memory` begin anew, where the system can."""
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
