"""wegs eval"""

import click

from core.errors import BadSetting
from core.evaluation import PROTOCOLS
from wegs_cli.options import DEFAULT_RUN, InputPath


@click.command("eval", short_help="Measure a run on its held-out photos.")
@click.option(
    "--run",
    "run_folders",
    type=InputPath(),
    multiple=True,
    help=f"Folder of the run; with --curve, repeatable.  {DEFAULT_RUN}",
)
@click.option(
    "--protocol",
    type=click.Choice(list(PROTOCOLS)),
    help="half: read the look from the left half of a test photo, score the right half; "
    "full: the whole photo for both.  [default: half; with --curve, both]",
)
@click.option("--no-refine", is_flag=True, help="Score only the look that the encoder reads (zero-shot).")
@click.option("--pictures", is_flag=True, help="Also write every render and photo as PNG into pictures/ in the run.")
@click.option("--curve", is_flag=True, help="Plot quality over time instead, in training and in refinement.")
def evaluate(run_folders, protocol, no_refine, pictures, curve) -> None:
    """Measure a run on the photos it was not trained on: PSNR, SSIM and, if its weights are installed, LPIPS.

    Writes results.json, per_view.json and sheet.png into the run (results_full.json and so on with --protocol full).
    With --curve, it writes figures into curves/ in the run, or in the first of several runs.

    \b
    Examples:
      wegs eval
      wegs eval --run runs/plaza --protocol full
      wegs eval --curve --run runs/a --run runs/b
    """
    if len(run_folders) > 1 and not curve:
        raise BadSetting("Several runs were given.", "Measure one at a time, or add --curve to draw them together.")
    if curve and pictures:
        raise BadSetting("--curve draws figures, and --pictures keeps renders.", "Type one of them.")
    if curve and no_refine and protocol:
        raise BadSetting(
            "--curve --no-refine draws the training alone, which has no protocol.", "Leave --protocol out."
        )

    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        if curve:
            from core.bench import suite

            suite.curves(run_folders, (protocol,) if protocol else tuple(PROTOCOLS), not no_refine, terminal)
        else:
            pipeline.evaluate(
                next(iter(run_folders), None),
                protocol or "half",
                terminal,
                refine=not no_refine,
                keep_pictures=pictures,
            )
