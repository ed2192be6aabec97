"""The program `wegs`; `python -m wegs_cli` is the same, also where that is not on the PATH."""

import sys

from wegs_cli import INTERRUPTED


def run() -> None:
    """Run `wegs_cli.main`, which handles Ctrl-C once it is loaded;
    until then, Ctrl-C ends the program without a word."""
    try:
        from wegs_cli.main import run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    run()
