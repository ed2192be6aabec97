"""wegs eval"""

from pathlib import Path

import click

from core.errors import BadSetting
from core.evaluation import PROTOCOLS


@click.command("eval", short_help="Measure a run on its held-out photos.")
@click.option(
    "--run",
    "run_folders",
    type=click.Path(path_type=Path),
    multiple=True,
    help="Folder of the run; with --curve, repeatable.  [default: the newest]",
)
@click.option(
    "--protocol",
    type=click.Choice(list(PROTOCOLS)),
    help="half: look from the left half of a test photo, figures from the right; full: both from the whole.  "
    "[default: half; with --curve, both]",
)
@click.option("--no-refine", is_flag=True, help="Take the encoder's embedding as it is.")
@click.option("--pictures", is_flag=True, help="Keep every render and photo as PNG, in the run's pictures/.")
@click.option("--curve", is_flag=True, help="Draw quality over time instead: of the training, and of the refinement.")
def evaluate(run_folders, protocol, no_refine, pictures, curve) -> None:
    """Measure a run on the photos it was not trained on: PSNR, SSIM and, where its weights are found, LPIPS.

    Writes results.json, per_view.json and sheet.png into the run, for the protocol `full` results_full.json and so on; --curve
    writes figures into its curves/ (of the first run, where several are drawn in one picture).

    \b
    Examples:
      wegs eval
      wegs eval --run runs/plaza --protocol full
      wegs eval --curve --run runs/a --run runs/b
    """
    if len(run_folders) > 1 and not curve:
        raise BadSetting("Several runs were given.", "Measure one at a time, or add --curve to draw them together.")

    from core import pipeline
    from core.bench import suite
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        if curve:
            suite.curves(run_folders, (protocol,) if protocol else tuple(PROTOCOLS), not no_refine, terminal)
        else:
            pipeline.evaluate(next(iter(run_folders), None), protocol or "half", terminal, refine=not no_refine, keep_pictures=pictures)
