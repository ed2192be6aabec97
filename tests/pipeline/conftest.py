"""The story end to end on six tiny photos: a run that all tests of this folder share."""

from dataclasses import replace

import pytest

from core import pipeline
from core.words import Note
from tests.heard import Heard
from tests.small import give_to_pipeline, small_collection, small_settings

STEPS = 12


@pytest.fixture(scope="package", autouse=True)
def small_scene(tmp_path_factory):
    """`pipeline` finds the small collection, whatever folder it is asked to read."""
    folder = tmp_path_factory.mktemp("scene")
    collection = replace(small_collection(folder), notes=(Note("photo_7.png was dropped: it is empty."),))
    with pytest.MonkeyPatch.context() as patch:
        give_to_pipeline(collection, patch)
        yield folder


@pytest.fixture(scope="package")
def trained(small_scene, tmp_path_factory):
    """A finished run and what was said on the way."""
    heard = Heard()
    output = tmp_path_factory.mktemp("runs") / "small"
    return pipeline.train(small_scene, small_settings(steps=STEPS), output, heard), heard
