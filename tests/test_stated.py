"""Numbers that the README states of what is built in are those of the code."""

from pathlib import Path

from core.config import Settings
from core.pipeline import evaluating
from core.presets import PRESETS

README = " ".join((Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8").split())


def test_the_sizes_of_presets_are_those_in_the_readme():
    quick, paper = ((PRESETS[name]["steps"], PRESETS[name]["max_gaussians"]) for name in ("quick", "paper"))
    assert (quick, paper) == ((1200, 20_000), (150_000, 3_000_000))
    assert "(1,200 steps, at most 20,000 Gaussians)" in README
    assert "(150,000 steps; the limit of 3,000,000 Gaussians is ours)" in README


def test_a_preview_is_drawn_at_every_quarter_as_the_readme_says():
    assert Settings().checkpoints == 4
    assert "Drawn anew at every quarter of the training" in README


def test_the_sheet_shows_as_many_photos_as_the_readme_says():
    assert evaluating.MOST_ROWS == 60
    assert "each held-out photo (of many, 60) beside its render" in README
