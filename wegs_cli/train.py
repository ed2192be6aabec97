"""wegs train"""

from pathlib import Path

import click
from click.core import ParameterSource

from core.errors import BadSetting, command
from wegs_cli.options import InputPath, OutputPath, WithSettings, settings_from, settings_options


@click.command(cls=WithSettings, short_help="Train a scene from photos; the result is a run.")
@click.argument("scene", type=InputPath(), required=False)
@click.option(
    "-o",
    "--output",
    type=OutputPath(),
    help="Folder of the run.  [default: runs/NAME after the scene's folder; NAME-2, NAME-3 ... if taken]",
)
@click.option(
    "--masks",
    type=InputPath(),
    help="Folder of masks, one per photo, named like it; white = use. "
    "wegs still learns masks of its own, unless --transients off is given.",
)
@settings_options
@click.option(
    "--resume",
    is_flag=True,
    help="Continue the stopped run in -o (default: the newest), with its own scene and settings.",
)
@click.option("--force", is_flag=True, help="Replace the run that -o holds.")
def train(scene, output, masks, preset_name, config, assignments, resume, force, **typed) -> None:
    """Train a scene whose look can follow any photo, from the photos in SCENE (default: the current folder).

    SCENE is a folder: of plain photos, whose cameras are then found first, or a COLMAP, PhotoTourism, nerfstudio,
    Instant-NGP, Blender or NeRF-OSR scene. Points are triangulated if the scene has none.

    The result is a run: a folder with the scene in its neutral look as a .ply, and all that `wegs bake` needs to write
    it in any other look.

    \b
    Examples:
      wegs train samples/plaza --preset quick
      wegs train photos/ -o runs/home -r 640 --set sky=none
      wegs train photos/ --masks people/
      wegs train --resume
    """
    if resume:
        _refuse_what_resuming_ignores(scene, output)
    elif force and output is None:
        raise BadSetting(
            "--force replaces the run that -o names, and there is no -o.", "Add -o, or leave --force out for a new run."
        )
    settings = None if resume else settings_from(preset_name, config, assignments, typed)

    from core import pipeline
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        if settings is None:
            pipeline.resume(output, terminal)
        else:
            pipeline.train(scene or Path("."), settings, output, terminal, force=force, masks=masks)


def _refuse_what_resuming_ignores(scene: Path | None, output: Path | None) -> None:
    """Raise BadSetting if anything but -o is given beside --resume."""
    from core.data.made import holds_run_config

    context = click.get_current_context()
    given = [
        "SCENE" if parameter.name == "scene" else parameter.opts[-1]
        for parameter in context.command.params
        if parameter.name not in ("resume", "output")
        and context.get_parameter_source(parameter.name) is ParameterSource.COMMANDLINE
    ]
    if scene is not None and given == ["SCENE"] and output is None and holds_run_config(scene):
        fix = f"Type: {command('wegs', 'train', '--resume', '-o', scene)}"
        raise BadSetting(f"--resume takes the run to go on with from -o, not {scene}.", fix)
    if given:
        raise BadSetting(
            f"{given[0]} has no effect on a resumed run, which keeps its scene and settings.",
            "Leave it out, or train a new run.",
        )
