"""Whole training steps on all threads, and part by part on one."""

import math
from pathlib import Path

import torch

from core.config import Settings
from core.training.trainer import Trainer
from samples.measurements.scenes import STEP_GAUSSIANS, STEP_SIZE_PX, plaza
from samples.measurements.stopwatch import CPU, WALL, Stopwatch

PROGRESS = 0.7  # of the run: by then masks hide, latents learn and L_regTS counts
WARM_UP, STEPS = 100, 60  # the first steps turn the haze of a fresh scene into surfaces
EVERYTHING = Settings(appearance="full", transients="on", sh_degree=1, device="cpu")
PLAIN = Settings(appearance="off", transients="off", sh_degree=1, device="cpu")


def trainer_of(scale: float, settings: Settings, size_px: tuple[int, int] = STEP_SIZE_PX) -> Trainer:
    """A Trainer in the middle of its run, with masks at work.
    scale: decides the number of Gaussians and of pixels, whatever `settings` say."""
    most = round(2 * STEP_GAUSSIANS * scale)  # a run starts with half of what it may grow to
    trainer = Trainer(plaza(scale, size_px), settings.changed(resolution=1, max_gaussians=most), Path())
    trainer.state.done = round(PROGRESS * trainer.settings.steps)
    return trainer


def measure_step(scale: float, settings: Settings) -> dict:
    """Steps without density control. The parts are timed on one thread, on which nothing runs beside anything else."""
    stopwatch, trainer, threads = Stopwatch(), trainer_of(scale, settings), torch.get_num_threads()
    whole = Stopwatch().repeat(trainer.step, math.ceil(WARM_UP * scale), math.ceil(STEPS * scale))["whole"]["median"]
    watch_step(trainer, stopwatch)
    torch.set_num_threads(1)
    parts = stopwatch.repeat(trainer.step, 1, math.ceil(STEPS * scale))
    torch.set_num_threads(threads)
    cameras = trainer.photos.cameras
    visible = [len(trainer.rasterizer.visible(trainer.gaussians.splats, camera).rows) for camera in cameras]
    facts = {
        "gaussians": trainer.gaussians.solid_count,
        "sky": trainer.gaussians.sky_count,
        "sh_degree": trainer.settings.sh_degree,
    }
    facts |= {"visible": round(sum(visible) / len(visible)), "from": min(visible), "to": max(visible)}
    facts |= {"threads": threads, "cpu_ms": round(1e3 * whole[CPU], 1), "wall_ms": round(1e3 * whole[WALL], 1)}
    return {"parts": parts, "facts": facts | {"size_px": f"{cameras[0].width} x {cameras[0].height}"}}


def watch_step(trainer: Trainer, stopwatch: Stopwatch) -> None:
    """Turn the calls that `trainer.step` makes on one thread into laps.

    The backward pass is one call; a hook on a tensor fires in it once everything made from the tensor is done. The last
    lap of it ends where Adam begins, and includes the check that gradients are finite.
    """
    outermost = True

    def watch(owner, method: str, part: str, hooked=None, part_behind: str = "", before: str = "everything else"):
        """hooked: picks the tensor of the result where a lap of `part_behind` ends. before: the lap until the call."""
        original = getattr(owner, method)

        def watched(*arguments, **named):
            nonlocal outermost
            if not outermost:  # such as the SH transfer of the gauge, which is part of the regularisers
                return original(*arguments, **named)
            stopwatch.lap(before)
            outermost = False
            result = original(*arguments, **named)
            outermost = True
            stopwatch.lap(part)
            if hooked is not None and hooked(result).requires_grad:
                hooked(result).register_hook(lambda gradient: stopwatch.lap(part_behind))
            return result

        setattr(owner, method, watched)

    watch(trainer.rasterizer, "visible", "rasterizer forward")
    watch(trainer.gaussians, "leaves", "gather")
    watch(trainer.objective, "gauge", "mask, regularisers")
    watch(trainer.model, "read", "encoder forward", lambda reading: reading.embedding, "SH transfer backward")
    watch(trainer.model, "transfer", "SH transfer forward", lambda result: result[0], "rasterizer backward")
    watch(trainer.rasterizer, "render", "rasterizer forward", lambda image: image, "picture loss")
    watch(trainer.objective, "picture", "picture loss", lambda loss: loss, "mask, regularisers")
    watch(trainer.objective, "transient", "mask, regularisers")
    watch(trainer.objective, "mask", "mask, regularisers", before="mask, regularisers")
    watch(
        trainer.gaussians,
        "step",
        "Adam",
        before="encoder backward" if trainer.model.encoder else "SH transfer backward",
    )
    if trainer.optimizer.learners:
        watch(trainer.optimizer, "step", "Adam", before="Adam")
