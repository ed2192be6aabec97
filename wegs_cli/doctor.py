"""wegs doctor"""

import sys

import click

from wegs_cli.options import InputPath


@click.command(short_help="Check a .ply, a run or a scene.")
@click.argument("what", required=False, type=InputPath())
def doctor(what) -> None:
    """Check WHAT and print one line per finding: what was found, what it means and what to do.
    Exit code 1 if anything needs doing.

    WHAT is a .ply of Gaussians (of any program), a run, a scene or a folder of photos; without it, the newest run.

    \b
    Examples:
      wegs doctor photos/
      wegs doctor runs/plaza
      wegs doctor dusk.ply
    """
    from core.doctor import examine
    from wegs_cli.terminal import Terminal

    with Terminal() as terminal:
        findings = examine(what, terminal)
    sys.exit(any(finding.advice for finding in findings))
