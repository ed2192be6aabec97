"""Cores that do not doze off while a step hands its work from thread to thread.

A virtual core without work is given back to the host, and comes back late and with cold caches. In a training step threads wait
for each other a hundred times, mostly for the interpreter lock and only for moments; on two virtual cores that was
a tenth to a sixth of the wall time. So each core gets a process of Linux's lowest class, SCHED_IDLE, that loops without doing anything:
it runs where nothing else wants to and makes way at once for what does. (A thread instead of the process could be suspended while it
holds the interpreter lock.)
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from core.system.threads import cores, threads

FEW = 4  # cores: more would burn more than a step can use
PROCESSOR = Path("/proc/cpuinfo")
CONTROL_GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
# It ends when it is killed, or when the process that started it, whose id is its argument, is gone.
BUSY_LOOP = """
import os, sys
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while os.getppid() == int(sys.argv[1]):
    for _ in range(100_000):
        pass
"""


@contextmanager
def cores_awake() -> Iterator[None]:
    """Keep every core of this machine awake meanwhile, where that is `worthwhile`. Also a decorator."""
    # A process group of their own: Ctrl-C is not for them. No session of their own: Linux shares time between sessions first.
    command, nowhere = [sys.executable, "-I", "-S", "-c", BUSY_LOOP, str(os.getpid())], subprocess.DEVNULL
    loops = []
    try:
        with suppress(OSError):  # where no more processes are allowed, it goes without
            for _ in range(threads() if worthwhile(threads()) else 0):
                loops.append(subprocess.Popen(command, process_group=0, stdin=nowhere, stdout=nowhere))
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def worthwhile(wanted: int) -> bool:
    """Whether this is Linux on at most FEW virtual cores, one for each of the `wanted` threads.

    Not in a container whose processor time is limited to less than its cores have: the busy loops would use up time for work.
    """
    if not hasattr(os, "SCHED_IDLE") or not 1 < wanted <= FEW or cores() != wanted:
        return False
    return _virtual() and not _allowed() < wanted


def _virtual() -> bool:
    try:
        return " hypervisor" in PROCESSOR.read_text()  # a flag of x86 processors
    except OSError:
        return False


def _allowed() -> float:
    """How many cores' worth of time the control groups of this process, and those above them, leave it."""
    return min(map(_quota, _groups()))


def _groups() -> list[Path]:
    """The folders of the control groups (version 2 and 1) that may limit this process's time."""
    groups = [CONTROL_GROUPS, CONTROL_GROUPS / "cpu"]  # in a container its own are often shown as the topmost
    with suppress(OSError, ValueError):
        for line in MEMBERSHIP.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers or "cpu" in controllers.split(","):
                top = CONTROL_GROUPS / ("cpu" if controllers else "")
                own = top / path.lstrip("/")
                groups += [group for group in (own, *own.parents) if group.is_relative_to(top)]
    return groups


def _quota(group: Path) -> float:
    try:
        quota, period = (group / "cpu.max").read_text().split()
    except (OSError, ValueError):
        try:
            quota, period = ((group / f"cpu.cfs_{what}_us").read_text() for what in ("quota", "period"))
        except OSError:
            return float("inf")
    return int(quota) / int(period) if quota != "max" and int(quota) > 0 else float("inf")
