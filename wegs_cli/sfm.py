"""wegs sfm"""

import click

from wegs_cli.options import InputPath, OutputPath


@click.command(short_help="Find the camera poses of photos.")
@click.argument("photos", type=InputPath())
@click.option("-o", "--output", required=True, type=OutputPath(), help="Folder of the scene, new or empty.")
def sfm(photos, output) -> None:
    """Find the camera poses of the photos in the folder PHOTOS with COLMAP.

    Writes undistorted photos and a COLMAP model, which `wegs train` reads.

    \b
    Example:
      wegs sfm photos/ -o scene/
    """
    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        pipeline.find_cameras(photos, output, terminal)
