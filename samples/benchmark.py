"""Time and memory of the engine, and its targets; scenes come from samples/plaza and fixed seeds.

    python samples/benchmark.py                                       # everything: three minutes on two idle cores
    OMP_NUM_THREADS=1 python samples/benchmark.py step --json step.json   # one measurement, one thread, and a file

step, plain-step: a training step, with everything on or off, and its parts on one thread. rasterizer: forward +
backward of a garden; plain-torch: the same by a rasterizer in plain torch. gaussians, pixels: how time and memory grow
with their number. threads: two against one. bake: a look, beside its matrix products. first-use: compiling the kernels.
samples/measurements describes each in detail.

CPU time is that of all threads. Each measurement runs in a separate process, so that its peak memory is its own.
Kernels are compiled in the warm-up, and the compiler takes memory: run the script twice if you want figures of memory.
The last table is Markdown.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import click
import rich
import rich.table
import torch

from core.bench.machine import made_on
from core.system.atomic import write_json
from core.system.outputs import check_file
from samples.measurements import arguments, baking, drawing, first_use, markdown, steps, targets, threads
from samples.measurements.stopwatch import CPU, WALL, peak_memory
from wegs_cli.main import OneLineErrors

SMALL = 0.01  # of all sizes

MEASUREMENTS: dict[str, Callable[[float], dict]] = {
    "step": partial(steps.measure_step, settings=steps.EVERYTHING),
    "plain-step": partial(steps.measure_step, settings=steps.PLAIN),
    "rasterizer": drawing.measure_rasterizer,
    "plain-torch": drawing.measure_plain_torch,
    "gaussians": drawing.measure_growth_in_gaussians,
    "pixels": drawing.measure_growth_in_pixels,
    "threads": threads.measure_threads,
    "bake": baking.measure_bake,
    "first-use": first_use.measure_first_use,
}


def measure(name: str, scale: float) -> dict:
    """A measurement, and the most memory that this process held until its end."""
    torch.manual_seed(0)
    measured = MEASUREMENTS[name](scale)
    return measured | {"peak_memory_mb": peak_memory() / 1e6}


def tables(name: str, measured: dict) -> list[rich.table.Table]:
    """A measurement's parts with their milliseconds, and its series, if it has one, with a row per size."""
    facts = ", ".join(f"{fact} {value}" for fact, value in measured["facts"].items())
    title = f"{name}: peak memory {measured['peak_memory_mb']:.0f} MB"
    table = partial(rich.table.Table, title=title, caption=facts)
    made = []
    if measured["parts"]:
        whole = measured["parts"].get("whole")
        profile = table("ms")
        for column in ("CPU median", "quartiles", "mean", "wall median", "share"):
            profile.add_column(column, justify="right", no_wrap=True)
        for part, spent in measured["parts"].items():
            low, median, high, mean = (
                f"{1e3 * spent[figure][CPU]:.1f}" for figure in ("low", "median", "high", "mean")
            )
            share = f"{spent['mean'][CPU] / whole['mean'][CPU]:.0%}" if whole else ""
            profile.add_row(part, median, f"{low} - {high}", mean, f"{1e3 * spent['median'][WALL]:.1f}", share)
        made.append(profile)
    if "series" in measured:
        series = table(*measured["series"]["columns"])
        for row in measured["series"]["rows"]:
            series.add_row(*(f"{value:.1f}" if isinstance(value, float) else f"{value}" for value in row))
        made.append(series)
    return made


@click.command(cls=OneLineErrors)
@click.argument("what", nargs=-1, type=click.Choice(list(MEASUREMENTS)))
@arguments.json_file
@click.option("--small", is_flag=True, help="A hundredth of all sizes, only to try it out.")
def main(what: tuple[str, ...], file: Path | None, small: bool) -> None:
    """Measure the time and memory of WHAT, or of everything."""
    if file:
        check_file(file)
    scale = SMALL if small else 1.0
    machine = made_on(0)
    measurements: dict[str, dict] = {}
    rich.print(machine)
    for name in what or MEASUREMENTS:
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # a fork would begin with this process's memory
            measurements[name] = pool.submit(measure, name, scale).result()
        rich.print(*tables(name, measurements[name]))
    click.echo(markdown.table(targets.HEADER, targets.lines(measurements)))
    if file:
        seconds = ["CPU", "wall"]
        write_json(file, {"machine": machine, "scale": scale, "seconds": seconds, "measurements": measurements})


if __name__ == "__main__":
    main()
