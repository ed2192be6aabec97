"""How many cores this process may use."""

import math
import os

from core.system import control_groups


def scheduled() -> int:
    """On how many cores the system runs this process (`taskset` and clusters allow some of them only)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cores() -> int:
    """How many cores' time this process may take: those above, or what a container (`docker --cpus`) or job allows.
    With more threads than that, all would be stopped for a part of every tenth of a second."""
    return min((scheduled(), *map(math.ceil, control_groups.cpu_quotas())))
