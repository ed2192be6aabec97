"""Scripts that measure looks refuse a run that has none, or none to measure them on."""

import pytest

from core.errors import BadInput
from samples.measurements.opened import opened
from tests.small import finished, small_collection, small_settings


@pytest.mark.parametrize(
    "settings, words", [({"appearance": "off"}, "has one look only"), ({"all_photos": True}, "has no held-out photos")]
)
def test_what_cannot_be_measured_is_refused(tmp_path, settings, words):
    collection = small_collection(tmp_path)
    collection = collection.undivided() if "all_photos" in settings else collection
    finished(collection, small_settings(steps=1, **settings), tmp_path / "run")
    with pytest.raises(BadInput, match=words):
        opened(tmp_path / "run")


def test_a_run_with_looks_and_held_out_photos_is_opened(tmp_path):
    finished(small_collection(tmp_path), small_settings(steps=1), tmp_path / "run")
    trained, held_out = opened(tmp_path / "run")
    assert trained.folder == tmp_path / "run" and [photo.name for photo in held_out] == ["photo_2.png", "photo_5.png"]
