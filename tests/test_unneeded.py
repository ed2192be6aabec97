"""A run that its photos decide stands beside its rival, each as often first, and alone where every part is needed."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from core.automatic import LEAST
from core.config import Settings
from samples import unneeded


def told(monkeypatch, tmp_path: Path, appearance: str) -> tuple[list[str], list[str]]:
    """The cells of a scene whose photos decide on this appearance, and the folders of its runs in their order;
    the nth run takes n seconds."""
    folders = []

    def measured(scene: Path, settings: Settings, folder: Path, terminal) -> unneeded.Measured:
        folders.append(folder.name)
        decided = settings.decided(
            appearance=appearance, transients="on", sh_degree=1, sky="dome", transparency="unseen", **LEAST
        )
        return unneeded.Measured(
            decided, float(len(folders)), 1_000_000 * (2 if settings.appearance == "auto" else 1), 20.0
        )

    monkeypatch.setattr(unneeded, "measure", measured)
    result = CliRunner().invoke(unneeded.main, [str(tmp_path), "--repeats", "2"], catch_exceptions=False)
    return [cell.strip() for cell in result.output.splitlines()[-1].strip("|").split("|")], folders


@pytest.mark.parametrize("appearance, rival", [("off", "vanilla"), ("exposure", "full")])
def test_a_scene_that_needs_less_is_measured_beside_its_rival_in_turns(monkeypatch, tmp_path, appearance, rival):
    cells, folders = told(monkeypatch, tmp_path, appearance)
    auto, other = f"{tmp_path.name}-auto", f"{tmp_path.name}-{rival}"
    assert folders == ["warm-up", auto, auto, other, other, auto]
    assert cells == [
        tmp_path.name,
        f"{appearance} / on / degree 1",
        "20.00",
        "4.5",
        "2.00",
        "20.00",
        "4.5",
        "1.00",
        "1.00",
        "2.00",
    ]


def test_a_scene_that_needs_everything_has_no_rival(monkeypatch, tmp_path):
    cells, folders = told(monkeypatch, tmp_path, "full")
    assert folders == ["warm-up", f"{tmp_path.name}-auto"] and cells[2:] == ["20.00", "2.0", "2.00", *["-"] * 5]
