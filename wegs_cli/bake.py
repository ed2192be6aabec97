"""wegs bake"""

import click

from wegs_cli.options import DEFAULT_RUN, InputPath, OutputPath


@click.command(short_help="Write the scene in the look of a photo, as a .ply.")
@click.option(
    "--appearance",
    required=True,
    metavar="PHOTO",
    help="A photo file, the name of a photo of the scene, a saved look, or `neutral`.",
)
@click.option("-o", "--output", required=True, type=OutputPath(), help="The .ply to write.")
@click.option("--run", "run_folder", type=InputPath(), help=f"Folder of the run.  {DEFAULT_RUN}")
@click.option("--force", is_flag=True, help="Replace the .ply if it exists, and a look saved as NAME.")
@click.option("--mask", type=InputPath(), help="Mask of PHOTO; white = use.")
@click.option(
    "--no-refine",
    is_flag=True,
    help="Keep the look that the encoder reads, even if the camera of PHOTO is known or can be found.",
)
@click.option(
    "--save-appearance",
    metavar="NAME",
    help="Also save the look in the run, as appearance/NAME.json, for a later --appearance NAME.",
)
@click.option(
    "--prune",
    type=click.Choice(["auto", "off"]),
    default="auto",
    show_default=True,
    help="auto: leave out Gaussians and SH bands that change no training view by more than half an 8-bit step "
    "(0.5/255). off: keep all.",
)
@click.option(
    "--sky/--no-sky", default=True, show_default=True, help="Include the sky, a distant dome around the place."
)
def bake(appearance, output, run_folder, force, mask, no_refine, save_appearance, prune, sky) -> None:
    """Write the scene in the look of a photo, as a .ply that every 3DGS viewer opens.

    The encoder reads the look from the photo. If the photo's camera is known (a photo of the scene) or can be found
    (another photo of the same place), the look is then refined until the scene, seen by that camera, fits the photo
    best.

    \b
    Examples:
      wegs bake --appearance dusk.jpg -o dusk.ply
      wegs bake --appearance neutral -o plain.ply --run runs/plaza
      wegs bake --appearance dusk.jpg -o dusk.ply --save-appearance dusk
    """
    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        pipeline.bake_to_file(
            run_folder,
            appearance,
            output,
            terminal,
            force=force,
            save_as=save_appearance,
            prune=prune == "auto",
            mask=mask,
            with_sky=sky,
            refine=not no_refine,
        )
