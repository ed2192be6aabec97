"""Where training starts: how the dome of the sky stands around the scene."""

import torch

from core.scene.quaternions import rotations


def test_the_skys_discs_face_the_scene(gaussians):
    sky = gaussians.splats[gaussians.solid :]
    outwards = torch.nn.functional.normalize(sky.means, dim=1)
    torch.testing.assert_close(rotations(sky.quaternions)[:, :, 2], outwards, rtol=0, atol=1e-5)
    assert (sky.log_scales.argmin(dim=1) == 2).all()
