"""Turns as unit quaternions."""

import torch

from core.scene.quaternions import from_z_onto, rotations


def test_the_shortest_turn_of_the_z_axis_ends_at_the_vector():
    vectors = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    vectors = torch.cat([vectors, torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])])
    turns = from_z_onto(vectors)
    torch.testing.assert_close(rotations(turns)[:, :, 2], vectors, rtol=0, atol=1e-5)
    torch.testing.assert_close(turns.norm(dim=1), torch.ones(len(turns)))
    assert (turns[:, 3] == 0).all()  # the axis of the shortest turn lies across z
