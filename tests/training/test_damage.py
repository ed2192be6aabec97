"""Run folders that were changed, damaged or made by another version: one line each, never a traceback."""

import json
import shutil

import pytest
import torch
from click.testing import CliRunner

from core.run import checkpoint
from tests.small import finished, small_collection, small_settings
from wegs_cli.main import wegs


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    root = tmp_path_factory.mktemp("trained")
    collection, settings = small_collection(root), small_settings(steps=3)
    return finished(collection, settings, root / "run").folder


def change_config(*path, value):
    def change(folder):
        facts = json.loads((folder / "config.json").read_text())
        place = facts
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        (folder / "config.json").write_text(json.dumps(facts))

    return change


def change_checkpoint(change):
    def apply(folder):
        saved = checkpoint.load(checkpoint.newest(folder))
        change(saved)
        checkpoint.save(folder, saved)

    return apply


MEANS = "gaussians.parameters.means"
DAMAGE = {
    "another embedding size": (change_config("settings", "embedding_size", value=8), "does not fit its run"),
    "a setting of another version": (change_config("settings", "opacity_resets", value=1), "There is no setting"),
    "a radius of zero": (change_config("frame", "radius", value=0), "no frame"),
    "a radius of NaN": (change_config("frame", "radius", value=float("nan")), "no frame"),
    "a centre of two numbers": (
        change_config("photos", 0, "camera", "centre", value=[1, 2]),
        "config.json cannot be used",
    ),
    "a camera of no width": (change_config("photos", 0, "camera", "width", value=0), "a picture of 0x36 px"),
    "a focal length in words": (
        change_config("photos", 0, "camera", "fx", value="wide"),
        "config.json cannot be used: ValueError",
    ),
    "a focal length beyond all floats": (
        change_config("photos", 0, "camera", "fx", value=10**400),
        "config.json cannot be used: ValueError",
    ),
    "a photo without a path": (change_config("photos", 0, "path", value=None), "config.json cannot be used"),
    "a split that there is not": (change_config("photos", 0, "split", value="val"), "of the split 'val'"),
    "no photos": (change_config("photos", value=[]), "no photos"),
    "a setting left open": (change_config("settings", "steps", value=-1), "steps is left open"),
    "a missing tensor": (change_checkpoint(lambda saved: saved.tensors.pop(MEANS)), "does not fit its run"),
    "missing counts": (change_checkpoint(lambda saved: saved.tensors.pop("gaussians.counts")), "KeyError: 'counts'"),
    "a moment of another shape": (
        change_checkpoint(
            lambda saved: saved.tensors.update({"gaussians.second.sh": saved.tensors["gaussians.second.sh"][:, :1]})
        ),
        "moments of other shapes",
    ),
    "a sky of more than all": (change_checkpoint(lambda saved: saved.facts.update(sky=10**6)), "a sky of 1000000 of"),
    "missing facts": (change_checkpoint(lambda saved: saved.facts.pop("trainer")), "KeyError: 'trainer'"),
    "another length": (
        change_checkpoint(lambda saved: saved.tensors.update({MEANS: torch.zeros(3, 3)})),
        "Gaussians in tensors of one set",
    ),
    "another type": (
        change_checkpoint(lambda saved: saved.tensors.update({MEANS: saved.tensors[MEANS].double()})),
        "not float32",
    ),
    "an empty checkpoint": (lambda folder: checkpoint.newest(folder).write_bytes(b""), "is not a readable checkpoint"),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("command", ["bake --appearance neutral -o look.ply --run", "doctor"])
def test_a_damaged_run_is_reported_in_one_line(trained, tmp_path, monkeypatch, damage, command):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(trained, tmp_path / "run")
    spoil, words = DAMAGE[damage]
    spoil(tmp_path / "run")
    result = CliRunner().invoke(wegs, [*command.split(), "run"])
    assert result.exit_code == 1 and isinstance(result.exception, SystemExit), result.exception
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("wegs: run/") and words in line and not (tmp_path / "look.ply").exists()
