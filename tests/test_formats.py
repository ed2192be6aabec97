"""Runs on photos whose cameras other programs found:
from their files to a run that is stopped, resumed, measured and baked."""

import json
import shutil

import numpy as np
import pytest
import torch

from core import pipeline
from core.doctor import examine
from core.looks.trained import load_run
from core.run import checkpoint
from tests.data.converted import write_blender, write_nerf_osr, write_nerfstudio
from tests.data.room_corner import write_corner
from tests.data.small_scene import SmallScene
from tests.heard import Heard, StopsAtStep
from tests.small import small_settings

STEPS = 10


@pytest.fixture(scope="module")
def corner(tmp_path_factory):
    """A scene without points, one of whose photos has a mask."""
    return write_corner(tmp_path_factory.mktemp("corner"), masked=5)


@pytest.fixture(scope="module")
def trained(corner, tmp_path_factory):
    """A finished run on it and what was said."""
    heard = Heard()
    folder = tmp_path_factory.mktemp("runs") / "corner"
    return pipeline.train(corner, small_settings(steps=STEPS, resolution=8), folder, heard), heard


def test_points_are_triangulated_beside_the_run(trained, corner):
    folder, heard = trained
    said = "\n".join(heard.lines)
    for words in (
        "has cameras but no points",
        f"{corner.name} (nerfstudio): 6 photos (5 train, 1 test)",
        "\n1 photo with a mask from",
    ):
        assert words in said
    assert sorted(path.name for path in folder.parent.iterdir()) == ["corner", f"{corner.name}-scene"]
    entries = json.loads((folder / "cameras.json").read_text())
    frames = json.loads((corner / "transforms.json").read_text())["frames"]
    poses = {frame["file_path"]: np.array(frame["transform_matrix"]) for frame in frames}
    for entry in entries:  # OpenCV axes in place of OpenGL's; float64 in both
        pose = poses[entry["img_name"]]
        assert np.allclose(entry["position"], pose[:3, 3], rtol=0, atol=1e-12)
        assert np.allclose(entry["rotation"], pose[:3, :3] * [1, -1, -1], rtol=0, atol=1e-12)


def test_a_resumed_run_uses_the_same_points(trained, corner, tmp_path):
    whole = load_run(trained[0])
    shutil.copytree(trained[0].parent / f"{corner.name}-scene", tmp_path / f"{corner.name}-scene")
    folder = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        pipeline.train(
            corner, small_settings(steps=STEPS, resolution=8, checkpoints=10), folder, StopsAtStep(STEPS // 2)
        )
    assert checkpoint.newest(folder) is not None
    pipeline.resume(folder)
    resumed = load_run(folder)
    for name, tensor in whole.splats.tensors().items():
        assert torch.equal(getattr(resumed.splats, name), tensor), name


def test_the_run_can_be_evaluated_baked_interpolated_and_examined(trained, tmp_path, few_steps):
    folder, _ = trained
    assert pipeline.evaluate(folder, refine=False).means()["photo"]["zero_shot"]["psnr"] > 5  # dB, after ten steps
    assert pipeline.bake_to_file(folder, "3.png", tmp_path / "look.ply").stat().st_size > 1000
    assert len(list(pipeline.interpolate(folder, "1.png", "2.png", 2, tmp_path / "fade").glob("frame_*.png"))) == 2
    assert {finding.name for finding in examine(folder, Heard())} > {"steps", "looks"}


@pytest.mark.parametrize(
    "write", [write_nerfstudio, write_blender, lambda given, root: write_nerf_osr(given, root, splits(given))]
)
def test_the_doctor_examines_scenes_of_every_format(write, tmp_path):
    names = [f"photo_{index}.png" for index in range(9)]
    root = write(SmallScene(names=names, model="SIMPLE_PINHOLE").write(tmp_path / "colmap"), tmp_path / "scene")
    findings = {finding.name: finding for finding in examine(root, Heard())}
    assert "training and" in findings["scene"].figure
    assert {name for name, finding in findings.items() if finding.advice} <= {"points"}  # which are 20


def splits(given):
    names = sorted(path.name for path in (given / "images").iterdir())
    return {name: "test" if number % 4 == 0 else "train" for number, name in enumerate(names)}


def test_points_from_a_file_can_be_trained_on_without_knowing_which_photo_sees_them(tmp_path):
    root = write_nerfstudio(
        SmallScene(names=[f"{index}.png" for index in range(9)]).write(tmp_path / "colmap"), tmp_path / "scene"
    )
    settings = small_settings(steps=STEPS).changed(appearance="auto", transients="auto", sh_degree=-1)
    heard = Heard()
    folder = pipeline.train(root, settings, tmp_path / "run", heard)
    assert not (tmp_path / "scene-scene").exists()
    said = "\n".join(heard.lines)
    assert "Nothing says which photo sees which point" in said
    assert (
        "appearance=full: too few points are known to be shared by photos to tell whether their light differs" in said
    )
    assert load_run(folder).settings.sh_degree == 1
