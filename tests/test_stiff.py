"""The variants of plaza that `samples/stiff.py` spoils are spoilt as it says."""

import cv2
import numpy as np
import pycolmap
import pytest
from click.testing import CliRunner

from samples import stiff


@pytest.fixture(scope="module")
def plain():
    return pycolmap.Reconstruction(stiff.SCENE / "dense" / "sparse")


def centres(model):
    return np.stack(
        [image.projection_center() for image in sorted(model.images.values(), key=lambda image: image.name)]
    )


def test_worlds_are_scaled_and_moved(plain, tmp_path):
    for name, scale, offset in (("coordinates at 5e6", 1.0, 5e6), ("scene x 1e-4", 1e-4, 0.0)):
        folder = stiff.spoilt(tmp_path / name, stiff.CASES[name])
        model = pycolmap.Reconstruction(folder / "dense" / "sparse")
        expected = scale * centres(plain) + offset * np.array([1, -1, 1])
        np.testing.assert_allclose(centres(model), expected, rtol=0, atol=1e-6)
        assert {path.name for path in folder.iterdir()} == {"dense", "plaza.tsv"}


def test_two_training_photos_have_wrong_cameras_or_no_picture(plain, tmp_path):
    cameras = stiff.spoilt(tmp_path / "cameras", stiff.CASES["two wrong cameras"])
    model = pycolmap.Reconstruction(cameras / "dense" / "sparse")
    wide = [camera.focal_length_x > 1e6 for camera in model.cameras.values()]
    far = np.linalg.norm(centres(model) - centres(plain), axis=1) > 1e5
    assert sum(wide) == 1 and far.sum() == 1
    photos = stiff.spoilt(tmp_path / "photos", stiff.CASES["a black and a white photo"]) / "dense" / "images"
    means = [cv2.imread(str(path)).mean() for path in photos.iterdir()]
    assert sum(mean < 1 for mean in means) == sum(mean > 254 for mean in means) == 1


def test_what_an_earlier_run_left_is_made_again(plain, tmp_path):
    folder = stiff.spoilt(tmp_path / "scene", stiff.CASES["scene x 1e4"])
    (folder / "plaza.tsv").unlink()
    next((folder / "dense" / "images").iterdir()).write_bytes(b"of another plaza")
    assert stiff.spoilt(folder, stiff.CASES["as it is"]) == folder
    np.testing.assert_allclose(centres(pycolmap.Reconstruction(folder / "dense" / "sparse")), centres(plain))
    copied = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != "sparse"]
    for path in copied:
        assert path.read_bytes() == (stiff.SCENE / path.relative_to(folder)).read_bytes()
    assert len(copied) > 60


def test_what_cannot_be_measured_is_refused_before_plaza_is_copied(tmp_path):
    (tmp_path / "file").touch()
    for line in (["--steps", "0", "-o", str(tmp_path / "runs")], ["-o", str(tmp_path / "file")]):
        result = CliRunner().invoke(stiff.main, line)
        assert result.exit_code in (1, 2) and result.output.startswith("wegs: ") and result.output.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
