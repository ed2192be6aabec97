"""The annotations of the engine, the command line and the scripts hold, as far as mypy can tell;
shapes are checked where code runs (see pyproject.toml)."""

import subprocess
import sys
from pathlib import Path


def test_mypy_finds_no_fault(tmp_path):
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", tmp_path],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
