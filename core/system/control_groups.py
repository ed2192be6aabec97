"""What the control groups that this process is in allow it, cgroups(7): those of a container, or of a cluster's job."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

GROUPS, OF_PROCESS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def memory_limits() -> Iterator[int]:
    """The limit on memory, bytes, of each of its groups that has one."""
    for folder, version in _folders("memory"):
        with suppress(OSError, ValueError):  # none here; "max"
            yield int((folder / ("memory.limit_in_bytes" if version == 1 else "memory.max")).read_text())


def cpu_quotas() -> Iterator[float]:
    """The limit on CPU time over time, in cores, of each of its groups that has one."""
    for folder, version in _folders("cpu"):
        with suppress(OSError, ValueError):
            files = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if version == 1 else ("cpu.max",)
            quota, period = map(int, " ".join((folder / file).read_text() for file in files).split())
            if quota > 0 < period:  # -1 is no quota
                yield quota / period


def _folders(controller: str) -> Iterator[tuple[Path, int]]:
    """The folders that may hold this controller's limits, and the version of cgroups that names the files there.
    A container sees its own as the root."""
    with suppress(OSError):  # other systems have none
        for line in OF_PROCESS.read_text(errors="surrogateescape").splitlines():
            controllers, _, group = line.partition(":")[2].partition(":")
            if not controllers:
                roots, version = {GROUPS}, 2
            elif controller in controllers.split(","):  # mounted together, with a link for each
                roots, version = {GROUPS / controller, GROUPS / controllers}, 1
            else:
                continue
            for root in roots:
                own = root / group[1:]
                yield own, version
                yield from ((folder, version) for folder in own.parents if folder.is_relative_to(root))
