"""Plain 3DGS as gsplat trains it: its two kinds of density control,
with the learning rates and schedule of its simple_trainer."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from core.data.collection import Collection
from core.scene.harmonics import coefficient_count, dc_of_colour
from core.scene.splats import Splats
from core.training.gaussians.initialisation import spacings
from core.training.losses.photometric import photometric
from core.training.sized_photos import SizedPhotos
from samples.measurements.peer import picture

STEPS = 30_000  # what its schedule is written for
SSIM_WEIGHT = 0.2
STEPS_PER_DEGREE = 1000  # until SH of the next degree are used
FIRST_SCALE, LAST_MEAN_RATE = 1.1, 0.01
RATES = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3, "shN": 2.5e-3 / 20}
TIMES = ("refine_start_iter", "refine_stop_iter", "refine_every", "reset_every")  # of a strategy, in steps


@dataclass(frozen=True)
class Control:
    """A kind of density control. strategy: gsplat's class. opacity, scale: at the start.
    regularised: opacities and scales cost 0.01 each."""

    strategy: str
    opacity: float
    scale: float
    regularised: bool


CONTROLS = {"default": Control("DefaultStrategy", 0.1, 1.0, False), "mcmc": Control("MCMCStrategy", 0.5, 0.1, True)}


def trained_by(
    peer: ModuleType,
    control: Control,
    collection: Collection,
    photos: SizedPhotos,
    steps: int,
    most: int,
    degree: int,
    seed: int,
    on_progress: Callable[[int, int, str], None],
) -> Splats:
    """Train from the SfM points on `photos`. most: Gaussians, where the control has a limit. on_progress: called with
    the steps done, all of them, and what is to be said of the last."""
    torch.manual_seed(seed)
    centres = np.stack([camera.centre for camera in photos.cameras])
    extent = FIRST_SCALE * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
    parameters = first_parameters(collection, control, degree, photos.device)
    rates = RATES | {"means": RATES["means"] * extent}
    optimizers = {
        name: torch.optim.Adam([tensor], lr=rates[name], eps=1e-15, fused=True) for name, tensor in parameters.items()
    }
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizers["means"], LAST_MEAN_RATE ** (1 / steps))
    strategy = strategy_of(peer, control, steps, most)
    strategy.check_sanity(parameters, optimizers)
    grows_by_gradient = control.strategy == "DefaultStrategy"
    state = strategy.initialize_state(scene_scale=extent) if grows_by_gradient else strategy.initialize_state()
    order: list[int] = []
    for step in range(steps):
        order = order or torch.randperm(len(photos)).tolist()
        camera, target = photos.target(order.pop(), 1)
        splats = splats_of(parameters, min(degree, step * STEPS // steps // STEPS_PER_DEGREE))
        image, info = picture(peer, splats, camera)
        if grows_by_gradient:
            strategy.step_pre_backward(parameters, optimizers, state, step, info)
        loss = photometric(image, target, None, SSIM_WEIGHT)
        if control.regularised:
            loss = loss + 0.01 * (
                torch.sigmoid(parameters["opacities"]).mean() + torch.exp(parameters["scales"]).mean()
            )
        loss.backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        decay.step()
        given: dict[str, Any] = {"packed": False} if grows_by_gradient else {"lr": decay.get_last_lr()[0]}
        strategy.step_post_backward(parameters, optimizers, state, step, info, **given)
        on_progress(step + 1, steps, f"{len(parameters['means']):,} Gaussians")
    return splats_of(parameters, degree).detached()


def first_parameters(
    collection: Collection, control: Control, degree: int, device: torch.device
) -> dict[str, torch.nn.Parameter]:
    """Gaussians at all SfM points, as large as the distances to the nearest three, by gsplat's names."""
    points, count = collection.points, len(collection.points)
    scales = torch.from_numpy(spacings(points).clip(1e-7)) * control.scale
    started = {
        "means": torch.from_numpy(points),
        "scales": torch.log(scales)[:, None].repeat(1, 3),
        "quats": torch.rand(count, 4),
        "opacities": torch.logit(torch.full((count,), control.opacity)),
        "sh0": dc_of_colour(torch.from_numpy(collection.point_colours))[:, None],
        "shN": torch.zeros(count, coefficient_count(degree) - 1, 3),
    }
    return {name: torch.nn.Parameter(tensor.float().contiguous().to(device)) for name, tensor in started.items()}


def strategy_of(peer: ModuleType, control: Control, steps: int, most: int) -> Any:
    """gsplat's strategy, its times scaled to so many steps as by its `steps_scaler`."""
    strategy = getattr(peer, control.strategy)()
    for name in TIMES:
        if hasattr(strategy, name):
            setattr(strategy, name, max(1, getattr(strategy, name) * steps // STEPS))
    if hasattr(strategy, "cap_max"):
        strategy.cap_max = most
    return strategy


def splats_of(parameters: Mapping[str, Tensor], degree: int) -> Splats:
    """The Gaussians, with SH of at most this degree."""
    sh = torch.cat([parameters["sh0"], parameters["shN"][:, : coefficient_count(degree) - 1]], dim=1)
    return Splats(parameters["means"], parameters["quats"], parameters["scales"], parameters["opacities"], sh)
