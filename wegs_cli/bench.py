"""wegs bench"""

import click

from core.bench import FIGURES
from wegs_cli.options import InputPath, OutputPath


@click.command(short_help="Plot error against run time.")
@click.argument("scene", type=InputPath(), required=False)
@click.option("--run", "run_folder", type=InputPath(), help="Folder of a run to measure; nothing is trained.")
@click.option("--only", "names", type=click.Choice(FIGURES), multiple=True, help="Only this figure; repeatable.")
@click.option(
    "--full", is_flag=True, help="Presets up to 3,000 steps, three seeds, more views and repeats: an hour, not minutes."
)
@click.option("-o", "--output", type=OutputPath(), default="bench", show_default=True, help="Folder of the figures.")
@click.option("--force", is_flag=True, help="Replace the figures that OUTPUT holds.")
def bench(scene, run_folder, names, full, output, force) -> None:
    """Plot error against run time for rendering, baking, training and refinement, each as a table, CSV, JSON and PNG.

    Every preset is trained on SCENE (of any kind that `wegs train` reads) or, without one, on a small built-in scene,
    for a fifth of its steps (at most 600) and with 4,000 Gaussians; this takes under three minutes on two cores. With
    --run, that run is measured instead.

    \b
    Examples:
      wegs bench
      wegs bench samples/plaza --only training -o plaza-bench
      wegs bench --run runs/plaza --only baking
    """
    from core.bench import suite
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        suite.bench(
            scene,
            run_folder=run_folder,
            names=names or FIGURES,
            full=full,
            output=output,
            report=terminal,
            force=force,
        )
