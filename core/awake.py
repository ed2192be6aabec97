"""Cores that do not doze off while a step hands its work from thread to thread.

A virtual core without work is given back to the host, and comes back late and with cold caches. In a training step threads wait
for each other a hundred times, mostly for the interpreter lock and only for moments; on a machine of two virtual cores that
was a sixth of the wall time. So each core gets a thread of Linux's lowest class, SCHED_IDLE, which goes round in circles: it runs where
nothing else wants to, makes way at once for what does, and needs no lock of the interpreter's.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from core.compiled import kernel
from core.simd import fetch_add
from core.threads import threads

FEW = 4  # cores: more would burn more than a step can use
PROCESSOR = Path("/proc/cpuinfo")
CONTROL_GROUPS = Path("/sys/fs/cgroup")


@kernel
def _go_round(asked_to_leave):
    while fetch_add(asked_to_leave, 0, 0) == 0:
        pass


@contextmanager
def cores_awake() -> Iterator[None]:
    """Keep every core of this machine awake meanwhile, if it has few, all of them virtual and all for our threads. A decorator too."""
    asked_to_leave = np.zeros(1, np.int64)

    def stay() -> None:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))  # of this thread
        _go_round(asked_to_leave)

    if worthwhile(threads()):
        _go_round(np.ones(1, np.int64))  # compiled here: a compiler of the lowest class would hold the interpreter lock for long
        for _ in range(threads()):
            threading.Thread(target=stay, name="wegs-awake", daemon=True).start()
    try:
        yield
    finally:
        asked_to_leave[0] = 1


def worthwhile(wanted: int) -> bool:
    """Whether `wanted` threads have as many virtual cores to themselves, few of them, under Linux.

    A container that is allowed less time than its cores have would pay for the circles with time for work.
    """
    if not hasattr(os, "SCHED_IDLE") or not 1 < wanted <= FEW or len(os.sched_getaffinity(0)) != wanted:
        return False
    return _virtual() and not _allowed() < wanted


def _virtual() -> bool:
    try:
        return " hypervisor" in PROCESSOR.read_text()  # a flag of x86 processors
    except OSError:
        return False


def _allowed() -> float:
    """The cores' worth of time that control groups, second or first version, leave to this process."""
    try:
        quota, period = (CONTROL_GROUPS / "cpu.max").read_text().split()
    except (OSError, ValueError):
        try:
            quota, period = ((CONTROL_GROUPS / "cpu" / f"cpu.cfs_{what}_us").read_text() for what in ("quota", "period"))
        except OSError:
            return float("inf")
    return int(quota) / int(period) if quota != "max" and int(quota) > 0 else float("inf")
