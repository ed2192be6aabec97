"""The kernels of a step compiled before the first one, in two processes at once, where the cache does not hold them.

Numba compiles under a lock, so threads would wait for each other. While this process learns from a picture of a few
Gaussians, which compiles the rasterizer and the picture loss, another puts them into a look, and this one then finds
the kernels of the SH transfer in the cache.
"""

import subprocess
import sys
from contextlib import nullcontext, suppress

import numpy as np
import torch

import core.rasterizer
from core.appearance.sh_transfer import SHTransfer, TransferInput
from core.config import Settings
from core.kernels.compiled import at_first_compilation
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system import memory
from core.system.threads import threads
from core.training.losses.photometric import Target, photometric

PROCESS_BYTES = 1 << 30  # at most, of a process that compiles
LONGEST_S = 120  # that the other one is waited for
COUNT, SIDE_PX = 8, 16  # Gaussians; of the picture
ELSEWHERE = "import sys; sys.path[:] = sys.argv[1:]; from core.training import compiling; compiling.learn_look()"


def compile_kernels(looks: bool) -> None:
    """Compile what a step takes on a CPU, unless it is in the cache. looks: with the SH transfer, in another process
    where there is room for two."""
    others = []

    def start_other() -> None:
        with suppress(OSError):
            others.append(_learning_elsewhere())

    shared = looks and threads() > 1 and memory.fitting(PROCESS_BYTES) > 1 and sys.executable
    with at_first_compilation(start_other) if shared else nullcontext():
        learn_picture()
    for other in others:
        with suppress(subprocess.TimeoutExpired):
            other.wait(LONGEST_S)
    if looks:
        learn_look()


def _learning_elsewhere() -> subprocess.Popen:
    """`learn_look` in another process, which finds the modules that this one finds. It is left to finish after a
    Ctrl-C: what it compiles is kept."""
    nothing = subprocess.DEVNULL
    command = [sys.executable, "-c", ELSEWHERE, *sys.path]
    return subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True)


def learn_picture() -> None:
    """A picture of a few Gaussians, its loss, and their gradients."""
    along = torch.linspace(-1, 1, COUNT)
    splats = Splats(
        means=torch.stack([along, along, 3 + along], dim=1),
        quaternions=torch.eye(4)[:1].repeat(COUNT, 1),
        log_scales=torch.full((COUNT, 3), -1.0),
        logit_opacities=torch.zeros(COUNT),
        sh=torch.zeros(COUNT, 1, 3),
    )
    camera = Camera.centred(np.eye(3), np.zeros(3), SIDE_PX, SIDE_PX, SIDE_PX)
    rasterizer = core.rasterizer.create("cpu", "cpu")
    visible = rasterizer.visible(splats, camera)
    seen = splats[visible.rows].map(lambda tensor: tensor.requires_grad_())
    probe = torch.zeros(len(seen), 2, requires_grad=True)
    image = rasterizer.render(seen, camera, probe=probe, known=visible.known)
    photometric(image, Target(image.detach()), None, ssim_weight=0.2).backward()


def learn_look() -> None:
    """A look of a few Gaussians, and its gradients."""
    settings = Settings(sh_degree=0)
    sh, latents = torch.zeros(COUNT, 1, 3), torch.zeros(COUNT, settings.latent_size)
    base = TransferInput(sh.requires_grad_(), torch.zeros(COUNT, 3), latents.requires_grad_())
    with torch.random.fork_rng(devices=()):  # a training's own numbers stay as they are
        transfer = SHTransfer(settings)
    transfer(base, torch.zeros(settings.embedding_size)).sum().backward()
