"""gsplat, where it is installed: a picture, and a training step with its appearance MLP. wegs itself never uses it."""

from importlib import import_module
from types import ModuleType

import torch
from torch import Tensor, nn

from core.rasterizer.contract import BLUR_PX2, NEAR
from core.scene.camera import Camera
from core.scene.harmonics import MAX_DEGREE, SH_0, basis, coefficient_count
from core.scene.splats import Splats
from core.training.losses.photometric import Target, photometric

EMBEDDING, FEATURES, WIDTH = 16, 32, 64  # of gsplat's simple_trainer (AppearanceOptModule)
OPACITY_MOST = 0.98  # below both kernels' clamp of alpha, 0.99 here and 0.999 there: the constants are equal then


def gsplat() -> ModuleType | None:
    """The module, or None where it is not installed."""
    try:
        return import_module("gsplat")
    except ImportError:
        return None


def with_equal_constants(splats: Splats) -> Splats:
    """The splats without opacities so high that wegs and gsplat clamp them differently."""
    most = torch.logit(torch.tensor(OPACITY_MOST)).item()
    return Splats(**splats.tensors() | {"logit_opacities": splats.logit_opacities.clamp(max=most)})


def picture(peer: ModuleType, splats: Splats, camera: Camera, colours: Tensor | None = None) -> tuple[Tensor, dict]:
    """The picture (height, width, 3) by gsplat, and what its density control needs to know.
    colours: (N, 3), instead of the harmonics."""
    rotation, centre = torch.tensor(camera.world_to_camera), torch.tensor(camera.centre)
    view = torch.eye(4, dtype=torch.float64)
    view[:3, :3], view[:3, 3] = rotation, -rotation @ centre
    lens = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    image, _, info = peer.rasterization(
        means=splats.means, quats=splats.quaternions, scales=torch.exp(splats.log_scales),
        opacities=torch.sigmoid(splats.logit_opacities), colors=splats.sh if colours is None else colours,
        sh_degree=splats.degree if colours is None else None,
        viewmats=view[None].to(splats.means), Ks=lens[None].to(splats.means),
        width=camera.width, height=camera.height, near_plane=NEAR, eps2d=BLUR_PX2, packed=False,
    )  # fmt: skip
    return image[0], info


class PeerTrainer:
    """A training step as in gsplat's simple_trainer with `app_opt`:
    an MLP of (embedding, features, direction) gives the colours."""

    def __init__(self, peer: ModuleType, splats: Splats, photos: int):
        self.peer, device = peer, splats.means.device
        self.splats = splats.map(lambda tensor: tensor.detach().clone().requires_grad_())
        count, inputs = len(splats), EMBEDDING + FEATURES + coefficient_count(MAX_DEGREE)
        self.embeddings = torch.zeros(photos, EMBEDDING, device=device, requires_grad=True)
        self.features = torch.randn(count, FEATURES, device=device, requires_grad=True)
        layers = nn.Linear(inputs, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 3)
        self.network = nn.Sequential(*layers).to(device)
        parameters = *self.splats.tensors().values(), self.embeddings, self.features, *self.network.parameters()
        self.optimizer = torch.optim.Adam(parameters, lr=1e-3, fused=True)

    def step(self, photo: int, camera: Camera, target: Target) -> None:
        centre = torch.tensor(camera.centre).to(self.splats.means)
        directions = nn.functional.normalize(self.splats.means.detach() - centre, dim=1)
        given = self.embeddings[photo].expand(len(self.splats), -1), self.features, basis(directions, MAX_DEGREE)
        colours = torch.sigmoid(self.network(torch.cat(given, dim=1)) + SH_0 * self.splats.sh[:, 0])
        image, _ = picture(self.peer, self.splats, camera, colours)
        photometric(image, target, None, 0.2).backward()
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
