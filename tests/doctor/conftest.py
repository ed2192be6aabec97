"""A finished run that all tests of this folder share."""

import pytest

from core import pipeline
from tests.data.small_scene import SmallScene
from tests.small import small_settings


@pytest.fixture(scope="package")
def trained(tmp_path_factory):
    root = tmp_path_factory.mktemp("trained")
    scene = SmallScene(names=[f"photo_{index}.png" for index in range(9)]).write(root / "scene")
    return pipeline.train(scene, small_settings(steps=30, prune_contribution=0.0), root / "run")
