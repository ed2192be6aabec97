"""A run that is moved together with its scene goes on, and is measured and baked, as if it had stayed."""

import pytest
import torch

from core import pipeline
from core.run import checkpoint
from tests.data.small_scene import SmallScene
from tests.heard import Heard, StopsAtStep
from tests.small import small_settings

STEPS = 12


def test_a_run_that_is_moved_with_its_scene_is_resumed_measured_and_baked_as_if_it_had_stayed(tmp_path):
    before, after = tmp_path / "before", tmp_path / "after"
    scene = SmallScene(names=[f"photo_{index}.png" for index in range(9)]).write(before / "scene")
    stayed = pipeline.train(scene, small_settings(steps=STEPS), tmp_path / "stayed")
    figures = pipeline.evaluate(stayed, refine=False).views
    look = pipeline.bake_to_file(stayed, "photo_1.png", tmp_path / "stayed.ply").read_bytes()
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(scene, small_settings(steps=STEPS), before / "runs" / "x", StopsAtStep(5))
    before.rename(after)
    run, heard = after / "runs" / "x", Heard()
    assert pipeline.resume(run, heard) == run
    assert next(step for step in heard.steps if step[1] == STEPS) == (6, STEPS)
    moved, kept = (checkpoint.load(checkpoint.newest(folder)).tensors for folder in (run, stayed))
    assert moved.keys() == kept.keys()
    assert all(torch.equal(tensor, kept[name]) for name, tensor in moved.items())
    assert pipeline.evaluate(run, "half", heard, refine=False).views == figures
    assert pipeline.bake_to_file(run, "photo_1.png", tmp_path / "moved.ply", heard).read_bytes() == look
    assert not any("changed since" in line for line in heard.lines) and not before.exists()
