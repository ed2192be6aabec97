"""The picture of a run that needs no viewer: photos beside the scene from their cameras."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.export.labelled_sheet import GAP_PX, LABEL_PX
from core.export.pictures import to_8_bit
from core.looks.find_look import find_look
from core.looks.preview import PHOTOS, write_preview
from core.looks.trained import bake, drawn
from core.training.sized_photos import SizedPhotos
from tests.small import finished, small_collection, whole_settings


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return finished(
        small_collection(tmp_path_factory.mktemp("scene")),
        whole_settings(steps=20),
        tmp_path_factory.mktemp("runs") / "run",
    )


def training_photos(trained):
    return SizedPhotos(trained.collection.split("train"), trained.sizes)


def test_each_row_is_a_photo_the_scene_in_its_look_and_in_the_neutral_one(trained, tmp_path, monkeypatch):
    photos = training_photos(trained)
    assert len(photos) == PHOTOS
    with monkeypatch.context() as patch:
        patch.chdir(tmp_path)  # where other photos have the same names
        for sized in photos:
            cv2.imwrite(sized.photo.name, np.full((20, 20, 3), 255, np.uint8))
        path = write_preview(trained, photos)
    assert path == trained.folder / "preview.png"
    sheet = cv2.imread(str(path))[..., ::-1]
    height, width = photos[0].pixels.shape[:2]
    assert sheet.shape == (LABEL_PX + PHOTOS * (height + GAP_PX + LABEL_PX), 3 * (width + GAP_PX), 3)
    for number, sized in enumerate(photos):
        top = LABEL_PX + number * (height + GAP_PX + LABEL_PX)
        looks = (find_look(trained, word, refine=False) for word in (sized.photo.name, "neutral"))
        images = [to_8_bit(drawn(trained, bake(trained, look), sized.camera)) for look in looks]
        for column, expected in enumerate((sized.pixels, *images)):
            left = column * (width + GAP_PX)
            assert np.array_equal(sheet[top : top + height, left : left + width], expected)
        assert (images[0] != images[1]).any()


def test_a_run_of_one_look_shows_it_once_and_few_photos_make_few_rows(trained):
    plain = replace(trained, settings=trained.settings.changed(appearance="off"))
    photos = training_photos(trained)
    sheet = cv2.imread(str(write_preview(plain, [photos[0], photos[1]])))
    height, width = photos[0].pixels.shape[:2]
    assert sheet.shape[:2] == (LABEL_PX + 2 * (height + GAP_PX + LABEL_PX), 2 * (width + GAP_PX))


def test_a_run_in_training_is_shown_without_the_files_of_its_photos(trained):
    photos = list(training_photos(trained))
    finished = write_preview(trained, photos).read_bytes()
    gone = [replace(sized, photo=replace(sized.photo, path=sized.photo.path / "gone")) for sized in photos]
    assert write_preview(replace(trained, photo_embeddings=None), gone).read_bytes() == finished
