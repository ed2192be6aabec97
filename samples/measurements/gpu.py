"""Measures a GPU: by its own clock, by torch's profiler, and by what the compiler says about a kernel."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

import torch

LAUNCHES = ("cudaLaunchKernel", "cuLaunchKernel", "cudaLaunchKernelExC", "cuLaunchKernelEx", "cudaGraphLaunch")
WAITS = ("cudaStreamSynchronize", "cudaEventSynchronize", "cudaMemcpy")  # not cudaDeviceSynchronize: the profiler's own
COPIED_BYTES = 1 << 30
REGISTER_STEP, WARP = 256, 32  # registers are handed out to warps in such steps
# Blocks an SM, by capability; 32 on others (CUDA's programming guide).
BLOCKS_MOST = {(7, 5): 16, (8, 6): 16, (8, 7): 16, (8, 9): 24}
RESERVED_SHARED = 1024  # bytes that the driver takes of every block's shared memory


def event() -> torch.cuda.Event:
    """The moment, on the GPU's clock, at which all work started before it is done."""
    moment = torch.cuda.Event(enable_timing=True)
    moment.record()
    return moment


@dataclass(frozen=True)
class Place:
    """Where to measure; tests use a CPU with Triton's interpreter.

    mark: makes a moment, whose elapsed_time(later moment) is in ms. wait: until all work that was started is done.
    """

    device: torch.device = field(default_factory=lambda: torch.device("cuda"))
    mark: Callable = event
    wait: Callable[[], None] = torch.cuda.synchronize


class GpuStopwatch:
    """Like `stopwatch.Stopwatch`, but by the GPU's clock."""

    def __init__(self, place: Place):
        self.place = place

    def lap(self, part: str) -> None:
        self.marks.append((part, self.place.mark()))

    def repeat(self, work: Callable[[], object], warm_up: int, times: int) -> dict[str, float]:
        """Call work(), `warm_up` times unmeasured and then `times` measured: part -> median seconds."""
        runs = []
        for _ in range(warm_up + times):
            self.place.wait()
            self.marks = [("", self.place.mark())]
            work()
            self.lap("everything else")
            self.place.wait()
            laps = {"whole": self.marks[0][1].elapsed_time(self.marks[-1][1]) / 1e3}
            for (_, before), (part, after) in zip(self.marks, self.marks[1:]):
                laps[part] = laps.get(part, 0.0) + before.elapsed_time(after) / 1e3
            runs.append(laps)
        return {part: median(run[part] for run in runs[warm_up:]) for part in runs[-1]}


def in_turns(place: Place, works: dict[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """The median seconds of each of the works, which take turns, so that clocks and heat affect all alike."""
    stopwatch = GpuStopwatch(place)
    spent: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(1 + turns):
        for name, work in works.items():
            spent[name].append(stopwatch.repeat(work, 0, 1)["whole"])
    return {name: median(seconds[1:]) for name, seconds in spent.items()}


def copy_bandwidth(place: Place) -> float:
    """Bytes per second that a copy within the GPU's memory reads and writes:
    the ceiling for anything that only moves bytes."""
    size = COPIED_BYTES if place.device.type == "cuda" else 1 << 16
    source, target = (torch.empty(size, dtype=torch.uint8, device=place.device) for _ in range(2))
    return 2 * size / GpuStopwatch(place).repeat(lambda: target.copy_(source), 2, 9)["whole"]


@dataclass(frozen=True)
class Seen:
    """What the profiler saw: kernels started, waits of the host,
    and the seconds of each kernel on the GPU, by its name."""

    launches: int
    waits: int
    kernels: dict[str, float]


def profiled(work: Callable[[], object], place: Place) -> Seen:
    """What work() does on the GPU."""
    activities = [torch.profiler.ProfilerActivity.CPU]
    if place.device.type == "cuda":
        activities.append(torch.profiler.ProfilerActivity.CUDA)
    place.wait()
    with torch.profiler.profile(activities=activities) as profiler:
        work()
        place.wait()
    return seen(profiler.key_averages())


def seen(events: Iterable) -> Seen:
    """events: with key, count, device_time_total (µs) of what ran on the GPU, and is_user_annotation."""
    counts: dict[str, int] = {}
    kernels: dict[str, float] = {}
    for found in events:
        counts[found.key] = counts.get(found.key, 0) + found.count
        # What is named on the GPU's clock, as torch's optimizers name their steps, is around kernels that are there.
        if found.device_time_total and not found.cpu_time_total and not found.is_user_annotation:
            kernels[found.key] = found.device_time_total / 1e6
    launches, waits = (sum(counts.get(name, 0) for name in names) for names in (LAUNCHES, WAITS))
    return Seen(launches, waits, kernels)


def occupancy(registers: int, shared: int, warps: int, card) -> float:
    """The share of an SM's warps that can be resident at once, computed like NVIDIA's occupancy calculator.

    registers: per thread. shared: bytes per block. warps: per block. card: of torch.cuda.get_device_properties.
    """
    a_warp = -(-registers * WARP // REGISTER_STEP) * REGISTER_STEP
    most = card.max_threads_per_multi_processor // WARP
    by_registers = card.regs_per_multiprocessor // max(a_warp * warps, 1)
    by_shared = card.shared_memory_per_multiprocessor // (shared + RESERVED_SHARED)
    return min(by_registers, by_shared, most // warps, BLOCKS_MOST.get((card.major, card.minor), 32)) * warps / most


class Compiled(NamedTuple):
    """A compiled kernel: its name, registers per thread, bytes spilled, and occupancy."""

    name: str
    registers: int
    spilled: int
    occupancy: float


def compiled(modules: Iterable, card) -> list[Compiled]:
    """What Triton has compiled so far of the kernels in these modules."""
    found = []
    for module in modules:
        for name, kernel in vars(module).items():
            for caches in getattr(kernel, "device_caches", {}).values():
                for binary in caches[0].values():
                    share = occupancy(binary.n_regs, binary.metadata.shared, binary.metadata.num_warps, card)
                    found.append(Compiled(name, binary.n_regs, 4 * binary.n_spills, share))
    return sorted(set(found))
