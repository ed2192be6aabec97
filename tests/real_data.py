"""Real photo collections for tests that are the better for them;
not part of the project, so such tests skip without them."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data"


def real(name: str) -> Path:
    """The folder of a real collection, such as kermit; skips the test by name where it is not there."""
    if not (FOLDER / name).is_dir():
        pytest.skip(f"the real collection {name} is not on this machine")
    return FOLDER / name
