"""Values and cameras that no one would draw on purpose: nothing crashes, hangs, or lets one NaN through."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from core.rasterizer import BACKENDS, layout
from core.rasterizer.cpu import backend
from core.rasterizer.cpu.bin import SLOT, SPLAT
from core.scene.splats import Splats
from tests.rasterizer.backends import backend_or_skip, is_interpreted
from tests.rasterizer.scenes import camera, cloud

COUNT = 12
POISON = [
    float("nan"),
    float("inf"),
    float("-inf"),
    0.0,
    -0.0,
    1e-45,
    -1e-38,
    1e-6,
    88.0,
    -104.0,
    1e6,
    -1e12,
    1e30,
    3e38,
]
few = settings(max_examples=40, derandomize=True, deadline=None, database=None)
poisons = st.lists(
    st.tuples(
        st.sampled_from(["means", "quaternions", "log_scales", "logit_opacities", "sh"]),
        st.integers(0, COUNT - 1),
        st.integers(0, 2),
        st.sampled_from(POISON),
    ),
    max_size=8,
)
focal_lengths = st.sampled_from([1e-3, 1.0, 40.0, 3e6])
places = st.sampled_from([-1e6, -3.0, 8.0, 1e6])
ordinary = camera(17, 9)
cameras = st.just(ordinary) | st.builds(
    lambda width, height, fx, fy, cx, cy, x: camera(
        width, height, fx=fx, fy=fy, cx=cx, cy=cy, centre=np.array([x, -0.25, 1.0])
    ),
    st.integers(1, 35),
    st.integers(1, 20),
    focal_lengths,
    focal_lengths,
    places,
    places,
    st.sampled_from([0.5, -1e-40, 1e5, 1e12]),
)


def poisoned(values):
    splats = cloud(ordinary, COUNT, seed=31, degree=1, sizes_px=(0.5, 60.0))
    for parameter, row, column, value in values:
        # Colours are linear in the picture: beyond 1e6 a finite picture has gradients that float32 cannot hold.
        value = min(max(value, -1e6), 1e6) if parameter == "sh" and abs(value) < float("inf") else value
        tensor = getattr(splats, parameter)
        tensor[row].view(-1)[column * (tensor.dim() > 1)] = value
    return splats


@pytest.mark.parametrize("name", BACKENDS)
@few
@given(view=cameras, values=poisons)
# Float32 made a positive exponent of this needle, a million pixels off; and an infinite determinant of this one.
@example(view=camera(1, 1, fx=1e-3, fy=1.0, cx=-1e6, cy=-1e6), values=[("log_scales", 0, 0, 88.0)])
@example(view=camera(17, 9, fx=3e6, fy=3e6), values=[("log_scales", 0, axis, 88.0) for axis in range(3)])
def test_no_camera_and_no_value_makes_a_picture_or_a_gradient_non_finite(name, view, values):
    rasterizer, splats = backend_or_skip(name), poisoned(values).map(lambda tensor: tensor.requires_grad_())
    if is_interpreted(name):
        view = replace(view, width=min(view.width, 16), height=min(view.height, 16))
    probe = torch.zeros(COUNT, 2, requires_grad=True)
    image = rasterizer.render(splats, view, (0.1, 0.2, 0.3), probe)
    assert image.shape == (view.height, view.width, 3) and torch.isfinite(image).all()
    image.square().sum().backward()
    broken = ~splats.detached().finite_rows()
    for parameter, tensor in (splats.tensors() | {"probe": probe}).items():
        assert torch.isfinite(tensor.grad).all() and (tensor.grad[broken] == 0).all(), parameter
    contributions = rasterizer.contributions(splats.detached(), view)
    assert ((contributions >= 0) & (contributions <= 1)).all()
    unseen = torch.ones(COUNT, dtype=torch.bool)
    unseen[rasterizer.visible(splats.detached(), view).rows] = False
    assert (contributions[unseen] == 0).all()


@few
@given(view=cameras, values=poisons)
def test_footprints_are_finite_and_tile_lists_hold_what_they_announce(view, values):
    """The two stages between which integers are made of floats."""
    splats = poisoned(values)
    lists = backend.coloured_lists(backend.arrays_of(splats), backend.NOTHING, view)
    drawn = np.flatnonzero(np.diff(lists.slot_starts))
    footprints, coloured = lists.footprints[drawn], torch.isfinite(splats.sh).all(dim=(1, 2)).numpy()[drawn]
    assert np.isfinite(footprints[coloured]).all() and (footprints[~coloured, layout.STRENGTH] == -np.inf).all()
    assert (footprints[:, [layout.SHARPNESS, layout.FALL, layout.HALF_WIDTH, layout.HALF_HEIGHT]] > 0).all()
    tiles = -(-view.width // layout.TILE) * -(-view.height // layout.TILE)
    assert len(lists.tile_starts) == tiles + 1 and (np.diff(lists.tile_starts) >= 0).all()
    assert lists.tile_starts[-1] == lists.slot_starts[-1] == len(lists.entries) <= tiles * COUNT
    assert set(lists.entries[:, SPLAT]) == set(drawn)
    assert np.array_equal(np.sort(lists.entries[:, SLOT]), np.arange(len(lists.entries)))


@pytest.mark.parametrize("name", BACKENDS)
def test_a_colour_beyond_float32_is_not_drawn(name):
    """Of finite coefficients; and nothing of the others is changed by it."""
    rasterizer, view = backend_or_skip(name), camera(16, 9)
    splats = cloud(view, COUNT, seed=31, degree=1, sizes_px=(2.0, 5.0))
    # The signs of the basis where the camera looks.
    most = torch.finfo(torch.float32).max * torch.tensor([1.0, -1.0, 1.0, -1.0])
    middle = torch.from_numpy(view.centre + 2 * view.world_to_camera[2]).float()
    glaring = replace(splats[:1], means=middle[None], sh=most[None, :, None].expand(1, 4, 3))
    drawn = rasterizer.render(Splats.concatenate([glaring, splats]), view)
    assert torch.equal(drawn, rasterizer.render(splats, view))
