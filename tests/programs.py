"""Programs that run in a Python process of their own."""

import os
import subprocess
import sys

from tests.paths import ROOT


def run_python(
    program: str, *arguments: object, check: bool = True, timeout_s: float | None = None, **environment: str | None
) -> subprocess.CompletedProcess[str]:
    """What became of a program of this text, started in the repository's root.

    check: whether it has to end well. environment: variables that differ from those of this process; None: not there.
    """
    variables = {name: value for name, value in (os.environ | environment).items() if value is not None}
    command = [sys.executable, "-c", program, *map(str, arguments)]
    ended = subprocess.run(
        command, cwd=ROOT, env=variables, capture_output=True, text=True, check=False, timeout=timeout_s
    )
    if check:
        assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended
