"""What scripts use of gsplat, by our rasterizer for a CPU:
what is handed over comes back as the same picture, and strategies that only watch."""

from typing import ClassVar

import torch
from torch import Tensor

from core import rasterizer
from core.scene.camera import Camera
from core.scene.harmonics import SH_0
from core.scene.splats import Splats


def rasterization(
    means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane, sh_degree, eps2d, packed
) -> tuple[Tensor, None, dict]:
    """The picture, and the projected centres of all Gaussians, whose gradient is that of the picture."""
    view, lens = viewmats[0].double(), Ks[0]
    axes = view[:3, :3]
    focal_x, focal_y, middle_x, middle_y = (float(lens[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = Camera(axes.numpy(), (-axes.T @ view[:3, 3]).numpy(), focal_x, focal_y, middle_x, middle_y, width, height)
    sh = colors if sh_degree is not None else ((colors - 0.5) / SH_0)[:, None]
    splats, backend = Splats(means, quats, torch.log(scales), torch.logit(opacities), sh), rasterizer.create("cpu")
    visible = backend.visible(splats.detached(), camera)
    centres = torch.zeros(1, len(means), 2, requires_grad=True) * 1
    image = backend.render(splats[visible.rows], camera, probe=centres[0][visible.rows], known=visible.known)
    return image[None], None, {"means2d": centres}


class Watching:
    """A strategy of gsplat: what it was told, and the Gaussians it was given. They stay as they are."""

    refine_start_iter, refine_stop_iter, refine_every = 500, 15_000, 100
    made: ClassVar[list["Watching"]] = []

    def __init__(self):
        self.made.append(self)
        self.steps: list[int] = []

    def check_sanity(self, parameters: dict, optimizers: dict) -> None:
        assert set(parameters) == set(optimizers)
        self.parameters = parameters


class DefaultStrategy(Watching):
    """Grows by the gradients of the projected centres."""

    reset_every = 3000

    def initialize_state(self, scene_scale: float) -> dict:
        return {"scene_scale": scene_scale}

    def step_pre_backward(self, parameters: dict, optimizers: dict, state: dict, step: int, info: dict) -> None:
        info["means2d"].retain_grad()

    def step_post_backward(
        self, parameters: dict, optimizers: dict, state: dict, step: int, info: dict, packed: bool
    ) -> None:
        assert not packed and info["means2d"].grad.abs().sum() > 0
        self.steps.append(step)


class MCMCStrategy(Watching):
    """Moves Gaussians, with noise that goes with the learning rate of centres."""

    cap_max = 1_000_000

    def initialize_state(self) -> dict:
        self.rates: list[float] = []
        return {}

    def step_post_backward(
        self, parameters: dict, optimizers: dict, state: dict, step: int, info: dict, lr: float
    ) -> None:
        self.steps.append(step)
        self.rates.append(lr)
