"""What tests of this folder share."""

import pytest

from core.data.sfm.landmarks import landmarks_of
from core.report import Report
from tests.data.room_corner import corner_with_points


@pytest.fixture(scope="session")
def corner(tmp_path_factory):
    """The corner and its points; photo 0 is held out."""
    return corner_with_points(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="session")
def known(corner):
    """What photos of the corner are located by."""
    return landmarks_of(corner, Report())
