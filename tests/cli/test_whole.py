"""Commands through the whole program: from a scene on disk to what a user takes away."""

import json

from click.testing import CliRunner

from core.export.ply import read_ply
from tests.data.small_scene import SmallScene
from wegs_cli.main import wegs


def test_a_scene_is_trained_baked_measured_and_blended_by_commands_alone(tmp_path, monkeypatch):
    SmallScene(names=[f"photo_{index}.png" for index in range(9)]).write(tmp_path / "scene")
    monkeypatch.chdir(tmp_path)

    def told(*words: str) -> str:
        result = CliRunner().invoke(wegs, words)
        assert result.exit_code == 0, result.output
        return result.output

    sizes = ("--steps", "3", "--max-gaussians", "300", "--device", "cpu")
    assert "Next: wegs bake" in told("train", "scene", "-o", "run", *sizes)
    told("bake", "--run", "run", "--appearance", "photo_1.png", "--no-refine", "-o", "look.ply")
    assert len(read_ply(tmp_path / "look.ply")) > 0
    told("eval", "--run", "run", "--no-refine")
    results = json.loads((tmp_path / "run" / "results.json").read_text(encoding="utf-8"))
    assert (results["steps"], results["photos"]["test"], results["refinement"]) == (3, 2, None)
    told("interpolate", "photo_1.png", "neutral", "--steps", "2", "--no-refine", "--run", "run", "-o", "fade")
    assert len(list((tmp_path / "fade").glob("frame_*.png"))) == 2
