"""wegs eval"""

from pathlib import Path

import click


@click.command("eval", short_help="Measure a run on its held-out photos.")
@click.option("--run", "run_folder", type=click.Path(path_type=Path), help="Folder of the run.  [default: the newest]")
@click.option(
    "--protocol",
    type=click.Choice(["half", "full"]),
    default="half",
    show_default=True,
    help="half: look from the left half of a test photo, figures from the right; full: both from the whole.",
)
@click.option("--no-refine", is_flag=True, help="Take the encoder's embedding as it is.")
def evaluate(run_folder, protocol, no_refine) -> None:
    """Measure a run on the photos it was not trained on: PSNR, SSIM and, where its weights are found, LPIPS.

    Writes results.json, per_view.json and a picture sheet into the run.

    \b
    Examples:
      wegs eval
      wegs eval --run runs/plaza --protocol full
    """
    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        pipeline.evaluate(run_folder, protocol, terminal, refine=not no_refine)
