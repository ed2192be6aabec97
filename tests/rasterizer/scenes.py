"""Named small scenes, one for each stiff case that a rasterizer must get right. All float32, as in training.

Gaussians are laid out in camera axes and in pixels, so that each scene says what its picture is made of, and moved into
the world afterwards. Depths are evenly spaced and shuffled: float32 and float64 then sort them alike.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from core.rasterizer.contract import NEAR
from core.scene.camera import Camera
from core.scene.harmonics import coefficient_count
from core.scene.splats import Splats

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # a rotation with no zero that matters
BACKGROUND = (0.2, 0.4, 0.1)
SCENES: dict[str, Callable[[], "Scene"]] = {}


@dataclass(frozen=True)
class Scene:
    """What to draw. margin: how near (relative) an alpha or a transmittance may come to a threshold before float32 and
    float64 may decide differently; wider where float32 is worse conditioned."""

    splats: Splats
    camera: Camera
    background: tuple[float, float, float] = BACKGROUND
    margin: float = 1e-4


def scene(function: Callable[[], Scene]) -> Callable[[], Scene]:
    """Enter the function under its name in SCENES."""
    SCENES[function.__name__] = function
    return function


def camera(width: int = 48, height: int = 32, focal: float = 40.0, turned: bool = True, **changes) -> Camera:
    """A camera at a place that float32 holds exactly, the principal point a little off the centre."""
    rotation = TURN if turned else np.eye(3)
    centre = np.array([0.5, -0.25, 1.0]) if turned else np.zeros(3)
    plain = Camera(rotation, centre, focal, focal, width / 2 + 0.3, height / 2 - 0.2, width, height)
    return replace(plain, **changes)


def cloud(
    view: Camera,
    count: int,
    *,
    seed: int,
    degree: int = 1,
    depths: tuple[float, float] = (1.0, 4.0),
    sizes_px: tuple[float, float] = (0.5, 5.0),
    ratio: float = 4.0,
    opacities: tuple[float, float] = (0.05, 0.9),
    spread: float = 1.1,
) -> Splats:
    """Gaussians all over the picture. sizes_px: of the longest axis. ratio: longest to shortest axis, at most. spread:
    the part of the picture (1: all) over which centres fall."""
    random = np.random.default_rng(seed)
    z = random.permutation(np.linspace(*depths, count)) if count > 1 else np.full(count, depths[0])
    u = (0.5 + spread * (random.random(count) - 0.5)) * view.width
    v = (0.5 + spread * (random.random(count) - 0.5)) * view.height
    local = np.stack([(u - view.cx) / view.fx * z, (v - view.cy) / view.fy * z, z], axis=1)
    size = np.exp(random.uniform(*np.log(sizes_px), count)) * np.abs(z) / view.fx
    axes = size[:, None] * ratio ** -random.random((count, 3))
    axes[:, 0] = size
    opacity = random.uniform(*opacities, count)
    sh = random.normal(0, 0.3, (count, coefficient_count(degree), 3))
    sh[:, 0] += 0.5
    return in_world(view, local, random.normal(size=(count, 4)), np.log(axes), np.log(opacity / (1 - opacity)), sh)


def double(splats: Splats) -> Splats:
    return splats.map(torch.Tensor.double)


def in_world(
    view: Camera, local, quaternions, log_scales, logit_opacities, sh, dtype: torch.dtype = torch.float32
) -> Splats:
    """Splats from arrays; `local` (N, 3) holds the means in camera axes."""
    means = np.asarray(local) @ view.world_to_camera + view.centre
    arrays = means, quaternions, log_scales, logit_opacities, sh
    return Splats(*[torch.tensor(np.asarray(array), dtype=dtype) for array in arrays])


def random_scene(degree: int) -> Scene:
    view = camera()
    return Scene(cloud(view, 80, seed=degree, degree=degree), view)


@scene
def random_degree_0() -> Scene:
    return random_scene(0)


@scene
def random_degree_1() -> Scene:
    return random_scene(1)


@scene
def random_degree_2() -> Scene:
    return random_scene(2)


@scene
def random_degree_3() -> Scene:
    return random_scene(3)


@scene
def needles() -> Scene:
    """Axis ratios up to a million, up to sixty pictures long:
    differences of products, as in the 2D covariance's determinant, would be noise."""
    view = camera()
    splats = cloud(view, 40, seed=10, sizes_px=(3.0, 3000.0))
    splats.log_scales[:, 1:] = splats.log_scales[:, :1] - torch.linspace(0, 1, 40)[:, None] * np.log(1e6)
    return Scene(splats, view, margin=2e-3)


@scene
def behind_camera() -> Scene:
    view = camera()
    return Scene(cloud(view, 40, seed=11, depths=(-4.0, 4.2)), view)


@scene
def at_the_near_plane() -> Scene:
    """Depths from half to three times the near limit; scales of a few pixels at that depth."""
    view = camera()
    return Scene(cloud(view, 31, seed=12, depths=(0.51 * NEAR, 3 * NEAR)), view)


@scene
def on_the_camera_centre() -> Scene:
    view = camera()
    splats = cloud(view, 20, seed=13)
    splats.means[::4] = torch.from_numpy(view.centre).float()
    return Scene(splats, view)


@scene
def opaque_stack() -> Scene:
    """Forty nearly opaque splats behind each other: alpha is clamped and most of them are never reached.

    Two clamped splats leave (1 - ALPHA_MAX)^2, which is 2e-6 below the stopping limit: the margin is narrower than that
    on purpose, for all backends must stop there.
    """
    view = camera(24, 24)
    splats = cloud(view, 40, seed=14, sizes_px=(30.0, 200.0), opacities=(0.99, 0.9999), spread=0.5)
    return Scene(splats, view, margin=1e-6)


@scene
def equal_depths() -> Scene:
    """All depths the same number: the index decides."""
    view = camera(turned=False)
    return Scene(cloud(view, 30, seed=15, depths=(2.0, 2.0), spread=0.6, sizes_px=(2.0, 8.0)), view)


@scene
def huge_splat() -> Scene:
    """One splat far larger than the picture, among small ones."""
    view = camera()
    splats = cloud(view, 20, seed=16)
    splats.log_scales[3] = 3.0
    return Scene(splats, view)


@scene
def wide_splats_beside_the_picture() -> Scene:
    """Centres up to three pictures away, where the Jacobian is clamped; footprints that reach into the picture."""
    view = camera()
    return Scene(cloud(view, 60, seed=17, spread=6.0, sizes_px=(20.0, 80.0)), view)


@scene
def three_thousand_on_one_pixel() -> Scene:
    view = camera(3, 3, focal=4.0)
    splats = cloud(view, 3000, seed=18, degree=0, sizes_px=(0.5, 1.0), opacities=(0.005, 0.02), spread=0.2)
    return Scene(splats, view, margin=2e-5)


def sized(width: int, height: int) -> Scene:
    view = camera(width, height, focal=30.0)
    return Scene(cloud(view, 30, seed=width * 100 + height, sizes_px=(0.5, 8.0), spread=1.5), view)


for _width, _height in [(1, 1), (1, 40), (40, 1), (15, 15), (16, 16), (17, 17), (33, 17), (15, 33)]:
    SCENES[f"picture_{_width}x{_height}"] = lambda width=_width, height=_height: sized(width, height)


@scene
def many_tiles() -> Scene:
    """Several tiles of any usual size both ways, none filled to its border, and splats that cross them."""
    view = camera(80, 55, focal=70.0)
    return Scene(cloud(view, 250, seed=32, degree=2, sizes_px=(0.3, 25.0)), view, margin=2e-5)


@scene
def principal_point_off_centre() -> Scene:
    view = camera(cx=7.0, cy=29.0)
    return Scene(cloud(view, 40, seed=19), view)


@scene
def principal_point_outside() -> Scene:
    """As in a crop of a larger picture."""
    view = camera(cx=-60.0, cy=75.0)
    return Scene(cloud(view, 40, seed=20), view)


@scene
def unequal_focal_lengths() -> Scene:
    view = camera(fx=25.0, fy=70.0)
    return Scene(cloud(view, 40, seed=21), view)


@scene
def far_from_the_origin() -> Scene:
    """4,096 units away, where rotated means are rounded by a hundredth of a pixel: subtract the centre first."""
    view = camera(centre=np.array([4096.0, -4096.0, 2048.0]))
    return Scene(cloud(view, 40, seed=22), view)


@scene
def quaternions_of_any_norm() -> Scene:
    """Norms from 1e-4 to 1e4, and three that are culled: zero, denormal, below the limit."""
    view = camera()
    splats = cloud(view, 40, seed=23)
    splats.quaternions *= torch.logspace(-4, 4, 40)[:, None]
    splats.quaternions[0] = 0.0
    splats.quaternions[1] = 1e-40
    splats.quaternions[2] = torch.nn.functional.normalize(splats.quaternions[2], dim=0) * 9e-7
    return Scene(splats, view)


@scene
def scales_outside_their_range() -> Scene:
    """Log scales that are clamped beside ordinary ones; so far away that the largest scale, e^10, is a few pixels."""
    view = camera()
    splats = cloud(view, 24, seed=24, depths=(1e5, 4e5), sizes_px=(0.5, 2.0))
    splats.log_scales[::4] = torch.tensor([12.0, 9.0, -30.0])
    splats.log_scales[1::4] = torch.tensor([-100.0, 9.0, 11.0])
    return Scene(splats, view)


@scene
def opacities_zero_faint_and_one() -> Scene:
    """Exactly 0 and 1 in float32, and on both sides of 1/255."""
    view = camera()
    splats = cloud(view, 24, seed=25)
    splats.logit_opacities[:8] = torch.tensor([-100.0, -60.0, 60.0, 100.0, -5.6, -5.5, -5.0, -7.0])
    return Scene(splats, view)


@scene
def poisoned() -> Scene:
    """NaN and Inf in each parameter in turn: those Gaussians are absent, their neighbours untouched."""
    view = camera()
    splats = cloud(view, 40, seed=26)
    row = 0
    for tensor in splats.tensors().values():
        for value in (float("nan"), float("inf"), float("-inf")):
            tensor[row].view(-1)[-1] = value
            row += 2
    return Scene(splats, view)


@scene
def nothing_visible() -> Scene:
    view = camera()
    return Scene(cloud(view, 12, seed=27, depths=(-5.0, -1.0)), view)


@scene
def all_beside_the_picture() -> Scene:
    view = camera(cx=500.0)
    return Scene(cloud(replace(view, cx=20.0), 12, seed=28), view)


@scene
def empty() -> Scene:
    view = camera()
    return Scene(cloud(view, 0, seed=29), view)


@scene
def single() -> Scene:
    view = camera()
    return Scene(cloud(view, 1, seed=30, sizes_px=(5.0, 5.0), spread=0.1), view)
