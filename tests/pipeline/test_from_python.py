"""What core/README.md shows of the engine's use from Python."""

import re
from pathlib import Path

import pytest

from core.export.ply import read_ply

TEXT = (Path(__file__).parents[2] / "core" / "README.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("few_steps")
def test_the_example_runs(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = re.search(r"^```python\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE).group(1)
    example = example.replace("runs/plaza", str(trained[0])).replace("samples/plaza/styles/dusk.jpg", "photo_2.png")
    exec(example, made := {})  # noqa: S102 - it is ours
    assert made["picture"].shape[2] == 3 and made["picture"].max() > 0.2
    assert len(read_ply(tmp_path / "dusk.ply")) <= len(made["splats"])
