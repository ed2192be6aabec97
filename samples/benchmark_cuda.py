"""The CUDA engine on a GPU, and its targets; beside gsplat, where that is installed.

    python samples/benchmark_cuda.py                        # everything
    python samples/benchmark_cuda.py picture --json gpu.json  # one measurement, and a file

picture: forward + backward of 1,000,000 Gaussians at 1920 x 1080. baked: frames per second, also of a vanilla .ply.
steps: whole training steps, their kernels and waits. paper: seconds per 1,000 steps of the preset `paper`, and hours
for all. kernels: bandwidth beside that of a copy, registers, spills, occupancy. samples/measurements/on_gpu.py
describes each in detail.

Times are medians by the GPU's clock (torch.cuda.Event); what is compared takes turns. The table is Markdown.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import torch

from core.bench.machine import made_on
from core.system import device
from core.system.atomic import write_json
from core.system.outputs import check_file
from samples.measurements import arguments, markdown
from samples.measurements.targets import HEADER
from wegs_cli.main import OneLineErrors

NAMES = ("picture", "baked", "steps", "paper", "kernels")


@click.command(cls=OneLineErrors)
@click.argument("what", nargs=-1, type=click.Choice(NAMES))
@arguments.json_file
def main(what: tuple[str, ...], file: Path | None) -> None:
    """Measure WHAT, or everything."""
    if file:
        check_file(file)
    if not device.can_use_gpu():
        raise click.ClickException(
            f"{device.fault_of_gpu() or 'torch finds no NVIDIA GPU here'}. There is nothing to measure without one."
        )
    from samples.measurements.gpu import Place
    from samples.measurements.on_gpu import MEASUREMENTS  # Triton, which is there with a GPU only

    machine, lines = made_on(0), []
    click.echo(f"{machine}\n\n{markdown.head(HEADER)}")
    for name in what or MEASUREMENTS:
        torch.manual_seed(0)
        for line in MEASUREMENTS[name](Place()):
            click.echo(markdown.row(line))
            lines.append(line)
    if file:
        write_json(file, {"machine": machine, "lines": lines})


if __name__ == "__main__":
    main()
