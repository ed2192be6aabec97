"""wegs interpolate"""

import click

from wegs_cli.options import DEFAULT_RUN, InputPath, OutputPath


@click.command(short_help="Fade from one look to another.")
@click.argument("first")
@click.argument("last")
@click.option(
    "--steps",
    type=click.IntRange(min=2),
    metavar="N",
    default=10,
    show_default=True,
    help="Number of frames, including both ends.",
)
@click.option(
    "--view",
    "views",
    metavar="NAME",
    multiple=True,
    help="Photo of the scene whose camera is used. Repeatable: the camera moves from each to the next, about what most "
    "of them show.  [default: the first held-out one]",
)
@click.option("--no-refine", is_flag=True, help="Keep the looks that the encoder reads; see `wegs bake`.")
@click.option("--ply", is_flag=True, help="Also write one .ply per frame.")
@click.option("-o", "--output", type=OutputPath(), help="Folder of the frames.  [default: FIRST-to-LAST]")
@click.option("--run", "run_folder", type=InputPath(), help=f"Folder of the run.  {DEFAULT_RUN}")
@click.option("--force", is_flag=True, help="Replace the frames that OUTPUT holds.")
def interpolate(first, last, steps, views, no_refine, ply, output, run_folder, force) -> None:
    """Fade from one look to another: frames, a contact sheet and a video.

    FIRST and LAST each are a photo file, the name of a photo of the scene, a saved look, or `neutral`.

    \b
    Examples:
      wegs interpolate noon.jpg dusk.jpg
      wegs interpolate neutral dusk.jpg --steps 24 --ply -o fade
      wegs interpolate neutral dusk.jpg --steps 48 --view 0001.jpg --view 0019.jpg
    """
    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        pipeline.interpolate(
            run_folder, first, last, steps, output, terminal, views=views, ply=ply, force=force, refine=not no_refine
        )
