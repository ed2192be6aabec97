"""Where training starts: spheres at the points, and how the dome of the sky stands around the scene."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.config import FIELDS
from core.rasterizer import create
from core.scene.camera import Camera
from core.scene.harmonics import colour
from core.scene.quaternions import rotations
from core.training.gaussians.initialisation import initial_gaussians, sky_dome
from tests.small import small_collection, small_settings, whole_settings


def starting_at(folder, points: list[list[float]], **changes):
    """The Gaussians that a run begins with, of a scene with these points."""
    given = small_collection(folder)
    collection = replace(
        given, points=np.array(points, dtype=np.float64), point_colours=given.point_colours[: len(points)]
    )
    return collection, initial_gaussians(
        collection, small_settings(sky="none", **changes), torch.Generator().manual_seed(0)
    )


def test_gaussians_start_as_faint_spheres_in_the_colours_of_their_points(tmp_path):
    """As wide as the distance of their three nearest neighbours (3DGS),
    but not so wide that they are haze over everything."""
    points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3], [9.0, 0.0, 0.0]]
    collection, gaussians = starting_at(tmp_path, points, largest_scale=2.0)
    splats = gaussians.splats
    squares = torch.tensor([0.01 + 0.04 + 0.09, 0.01 + 0.05 + 0.1, 0.04 + 0.05 + 0.13, 0.09 + 0.1 + 0.13])
    wanted = [*(squares / 3).sqrt().tolist(), 1.0]
    torch.testing.assert_close(splats.log_scales.exp(), torch.tensor(wanted).float()[:, None].expand(5, 3))
    assert torch.sigmoid(splats.logit_opacities).tolist() == pytest.approx([0.1] * 5)
    sides = torch.nn.functional.normalize(torch.arange(15.0).view(5, 3) - 7, dim=1)
    torch.testing.assert_close(colour(splats.sh, sides), torch.from_numpy(collection.point_colours))


def test_lone_and_coinciding_points_have_a_size(tmp_path):
    for points, size in (([[0.0] * 3], 0.1), ([[0.0] * 3] * 5, 1e-5)):
        scales = starting_at(tmp_path, points, largest_scale=2.0)[1].splats.log_scales.exp()
        torch.testing.assert_close(scales, torch.full((len(points), 3), size))


def test_the_skys_discs_face_the_scene(gaussians):
    sky = gaussians.splats[gaussians.solid_count :]
    outwards = torch.nn.functional.normalize(sky.means, dim=1)
    torch.testing.assert_close(rotations(sky.quaternions)[:, :, 2], outwards, rtol=0, atol=1e-5)
    assert (sky.log_scales.argmin(dim=1) == 2).all()


def test_the_dome_stands_four_times_as_far_off_as_cameras_that_are_not_astray(tmp_path):
    collection = small_collection(tmp_path)  # its cameras are 3 away
    for distance, radius in ((3.0, 30.0), (12.0, 48.0), (1e6, 30.0)):
        first, *others = collection.photos
        moved = replace(first, camera=replace(first.camera, centre=np.array([distance, 0.0, 0.0])))
        dome = sky_dome(replace(collection, photos=(moved, *others)), whole_settings())
        torch.testing.assert_close(dome.means.norm(dim=1), torch.full((len(dome),), radius))


@pytest.mark.parametrize(
    "changes",
    [{}, {"sky_radius": FIELDS["sky_radius"].metadata["high"], "sky_gaussians": 12}],
    ids=["usual", "extreme"],
)
def test_hardly_anything_shines_through_the_dome(tmp_path, changes):
    """Seen from the middle, in six directions. (Single pixels may let through a hundredth: blending stops there.)"""
    collection = replace(small_collection(tmp_path), point_colours=np.zeros((200, 3), np.float32))
    dome = sky_dome(collection, whole_settings(**changes))
    x, y, z = np.eye(3)
    for axes in ((x, y, z), (-x, y, -z), (z, y, -x), (-z, y, x), (x, -z, y), (x, z, -y)):
        camera = Camera(np.array(axes), np.zeros(3), 32.0, 32.0, 32.0, 32.0, 64, 64)
        assert create("cpu").render(dome, camera, (1.0, 1.0, 1.0)).mean() < 1e-3
