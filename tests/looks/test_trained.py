"""A run that is looked at: which photo a path means, how those from outside are read,
and at what size photos are measured."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from core import pipeline
from core.appearance.colouring import Colouring, blended
from core.doctor.views import cameras_beside
from core.looks.find_look import find_look
from core.looks.trained import Look, TrainedRun, blend
from core.scene.frame import SceneFrame
from tests.small import HEIGHT, WIDTH, finished, small_collection, small_settings


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> TrainedRun:
    """A run of seconds at half the photos' size."""
    folder = tmp_path_factory.mktemp("runs") / "small"
    collection = replace(
        small_collection(tmp_path_factory.mktemp("scene")), frame=SceneFrame(np.array([3.0, -2.0, 1.0]), 7.0)
    )
    return finished(collection, small_settings(steps=4, resolution=2), folder)


def test_a_training_photo_is_known_by_a_link_to_it(trained, tmp_path):
    link = tmp_path / "link.png"
    link.symlink_to(trained.collection.photo("photo_1.png").path)
    found, named = (find_look(trained, word, refine=False) for word in (str(link), "photo_1.png"))
    assert found.source == named.source == "training photo photo_1.png"
    assert torch.equal(found.colouring.embedding, named.colouring.embedding)


def test_a_photo_from_outside_is_read_without_its_predicted_mask(trained, tmp_path):
    own = trained.collection.photo("photo_2.png")
    outside = shutil.copy(own.path, tmp_path / "outside.png")
    picture = torch.from_numpy(cv2.imread(str(own.path))[..., ::-1].copy()).permute(2, 0, 1).float() / 255
    whole, masked = trained.model.embedding_from_outside(picture), trained.model.read(picture).embedding
    found = find_look(trained, str(outside)).colouring.embedding
    torch.testing.assert_close(found, whole)
    assert not torch.allclose(found, masked)


def test_looks_mix_in_shares_and_end_as_themselves():
    """One without a tone is one whose gains are 1."""
    embeddings = torch.randn(2, 6, generator=torch.Generator().manual_seed(0))
    day, night = (
        Look("day", "a photo", Colouring(embeddings[0])),
        Look("night", "a photo", Colouring(embeddings[1], torch.full((2, 3), 0.2))),
    )
    assert blend(day, night, 0.0) is day and blend(day, night, 1.0) is night
    mixed = blend(day, night, 0.25)
    torch.testing.assert_close(
        mixed.colouring.embedding, 0.75 * day.colouring.embedding + 0.25 * night.colouring.embedding
    )
    torch.testing.assert_close(mixed.colouring.tone, torch.full((2, 3), 0.8))
    assert mixed.name == "0.250 of the way from day to night" and blend(day, day, 0.5).colouring.tone is None


def test_looks_mix_what_goes_beyond_embeddings_too():
    """A look without a change of a weight is one whose change is zero."""
    plain = Colouring(torch.zeros(2))
    first, last = (
        plain._replace(changes={"a": torch.ones(2), "b": torch.ones(3)}),
        plain._replace(changes={"b": 3 * torch.ones(3)}),
    )
    mixed = blended(first, last, 0.25).changes
    assert {name: change.tolist() for name, change in mixed.items()} == {"a": [0.75] * 2, "b": [1.5] * 3}
    assert blended(plain, last, 0.5).changes["b"].tolist() == [1.5] * 3 and blended(plain, plain, 0.5).changes == {}


def test_results_tell_by_how_much_photos_were_shrunk(trained):
    assert pipeline.evaluate(trained.folder, refine=False).scale == 0.5


def test_the_cameras_of_a_run_are_read_as_they_were_written(trained):
    read = cameras_beside(trained.folder / "point_cloud.ply")
    collection = trained.collection
    assert len(read) == len(collection.photos)
    for camera, photo in zip(read, (*collection.split("train"), *collection.split("test")), strict=True):
        np.testing.assert_allclose(camera.world_to_camera, photo.camera.world_to_camera, rtol=0, atol=1e-12)
        np.testing.assert_allclose(camera.centre, collection.frame.to_world(photo.camera.centre), rtol=0, atol=1e-12)
        assert (camera.width, camera.height) == (WIDTH, HEIGHT)
