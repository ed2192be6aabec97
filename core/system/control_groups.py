"""What the control groups that this process is in allow it, cgroups(7): those of a container, or of a cluster's job."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

GROUPS, OF_PROCESS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def memory_limits() -> Iterator[int]:
    """Bytes."""
    for folder, version in _folders("memory"):
        with suppress(OSError, ValueError):  # none here; "max"
            yield int((folder / ("memory.limit_in_bytes" if version == 1 else "memory.max")).read_text())


def cpu_quotas() -> Iterator[float]:
    """CPU time over time: so many cores."""
    for folder, version in _folders("cpu"):
        with suppress(OSError, ValueError):
            files = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if version == 1 else ("cpu.max",)
            quota, period = map(int, " ".join((folder / file).read_text() for file in files).split())
            if quota > 0:  # -1 is no quota
                yield quota / period


def _folders(controller: str) -> Iterator[tuple[Path, int]]:
    """The folders that may hold this controller's limits, and the version of cgroups that names the files there.
    A container sees its own as the root."""
    with suppress(OSError):  # other systems have none
        for line in OF_PROCESS.read_text().splitlines():
            _, controllers, group = line.split(":", 2)
            if not controllers or controller in controllers.split(","):
                own = GROUPS / controllers / group[1:]
                for folder in (own, *own.parents):
                    yield folder, 1 if controllers else 2
