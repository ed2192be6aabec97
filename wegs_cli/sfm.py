"""wegs sfm"""

from pathlib import Path

import click


@click.command(short_help="Find where photos were taken.")
@click.argument("photos", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder of the scene, new or empty."
)
def sfm(photos, output) -> None:
    """Find where PHOTOS, a folder, were taken: undistorted pictures and a COLMAP model that `wegs train` reads.

    \b
    Example:
      wegs sfm photos/ -o scene/
    """
    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        pipeline.find_cameras(photos, output, terminal)
