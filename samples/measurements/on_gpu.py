"""What samples/benchmark_cuda.py measures on a GPU; each measurement yields the lines of its table."""

import tempfile
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import torch

from core import export, rasterizer
from core.appearance import positional_encoding_cuda
from core.appearance.model import AppearanceModel
from core.config import Settings
from core.export.ply import read_ply
from core.presets import preset
from core.rasterizer.cuda import bin, blend_backward, blend_forward, project, project_backward
from core.rasterizer.cuda.backend import prepare
from core.rasterizer.layout import FOOTPRINT_COLUMNS, SLOT_COLUMNS
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.training.gaussians import adam_cuda, chosen_rows_cuda, density_statistics_cuda
from core.training.losses import photometric_cuda, residual_cuda
from core.training.trainer import Trainer
from samples.measurements import peer
from samples.measurements.drawing import draw
from samples.measurements.gpu import GpuStopwatch, Place, compiled, copy_bandwidth, in_turns, profiled
from samples.measurements.scenes import BAKED, COEFFICIENTS, STEP_GAUSSIANS, garden, garden_camera
from samples.measurements.steps import EVERYTHING, trainer_of
from samples.measurements.targets import Line

GAUSSIANS, SIZE_PX = 1_000_000, (1920, 1080)
STEP_SIZES = (10_000, STEP_GAUSSIANS)
# Strewn over the sample, in photos as much larger; steps of its 150,000.
PAPER_GAUSSIANS, PAPER_STEPS_TIMED = 300_000, 1000
WARM_UP, TIMES, STEPS = 5, 25, 50
KERNEL_MODULES = (
    *(project, bin, blend_forward, blend_backward, project_backward),
    *(chosen_rows_cuda, adam_cuda, density_statistics_cuda, photometric_cuda, residual_cuda, positional_encoding_cuda),
)
PICTURES_ALIKE = 1e-4
MISSING = "gsplat is not installed: `pip install gsplat` compiles it on this machine"


def scene_of(place: Place) -> tuple[Splats, Camera]:
    """The garden, and its camera, at the sizes that the targets are for."""
    return garden(GAUSSIANS).map(lambda tensor: tensor.to(place.device)), garden_camera(*SIZE_PX)


def milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def against(seconds: float, theirs: float) -> str:
    return f"{milliseconds(seconds)}, gsplat {milliseconds(theirs)}: {theirs / seconds:.2f}x faster"


def measure_picture(place: Place) -> Iterable[Line]:
    """Forward and backward, by parts; the same beside gsplat's, taking turns,
    and the difference between the two pictures."""
    (scene, camera), backend, stopwatch = (
        scene_of(place),
        rasterizer.create("cuda", place.device.type),
        GpuStopwatch(place),
    )
    what = f"forward + backward, {len(scene):,} Gaussians, {camera.width} x {camera.height}"
    parts = stopwatch.repeat(lambda: draw(backend, scene, camera, stopwatch.lap), WARM_UP, TIMES)
    yield Line(f"{what}, by parts", "", ", ".join(f"{part} {milliseconds(spent)}" for part, spent in parts.items()))
    other = peer.gsplat()
    if other is None:
        yield Line(what, "1.5x faster than gsplat, picture within 1e-4", f"{milliseconds(parts['whole'])}; {MISSING}")
        return
    scene = peer.with_equal_constants(scene)

    def theirs() -> None:
        leaves = scene.map(lambda tensor: tensor.detach().requires_grad_())
        image, _ = peer.picture(other, leaves, camera)
        image.backward(torch.ones_like(image))

    medians = in_turns(place, {"ours": lambda: draw(backend, scene, camera), "theirs": theirs}, TIMES)
    yield Line(what, "1.5x faster than gsplat", against(medians["ours"], medians["theirs"]))
    with torch.no_grad():
        difference = (backend.render(scene, camera) - peer.picture(other, scene, camera)[0]).abs()
    # Where an alpha stands at its threshold: gsplat rounds by fast-math.
    beyond = (difference > PICTURES_ALIKE).any(dim=2)
    found = (
        f"mean {float(difference.mean()):.1e}; "
        f"{int(beyond.sum())} of {beyond.numel():,} pixels beyond, by {float(difference.max()):.1e} at most"
    )
    yield Line("picture against gsplat's, constants equal", f"within {PICTURES_ALIKE:.0e}", found)


def measure_baked(place: Place) -> Iterable[Line]:
    """Frames per second of a baked look and of a .ply of the same Gaussians
    into which no look was baked, taking turns."""
    (scene, camera), backend = scene_of(place), rasterizer.create("cuda", place.device.type)
    model = AppearanceModel(BAKED, ()).to(place.device)
    latents = torch.zeros(len(scene), BAKED.latent_size, device=place.device)
    with tempfile.TemporaryDirectory() as folder:
        looks = {"baked": model.bake(scene, model.mean_embedding, latents), "vanilla": scene}
        for name, look in looks.items():
            export.write(Path(folder) / f"{name}.ply", look, "benchmark")
            looks[name] = read_ply(Path(folder) / f"{name}.ply").map(lambda tensor: tensor.to(place.device))
    with torch.no_grad():
        medians = in_turns(place, {name: partial(backend.render, look, camera) for name, look in looks.items()}, TIMES)
    what = f"{len(scene):,} baked Gaussians at {camera.width} x {camera.height}"
    yield Line(
        what,
        "over 300 frames a second",
        f"{1 / medians['baked']:.0f} frames a second, {milliseconds(medians['baked'])}",
    )
    yield Line("a baked look against a vanilla .ply", "1.00 +- 0.02", f"{medians['baked'] / medians['vanilla']:.3f}")


def trainer_at(place: Place, gaussians: int, settings: Settings) -> Trainer:
    """A Trainer in the middle of a run on so many Gaussians, past its first steps."""
    where = {"device": place.device.type, "backend": "cuda"}
    trainer = trainer_of(gaussians / STEP_GAUSSIANS, settings.changed(**where))
    for index in range(len(trainer.photos)):
        trainer.photos.target(index, 1)  # a run makes each once
    for _ in range(WARM_UP):
        if told := trainer.step().messages:  # that steps cannot be recorded, for example
            raise RuntimeError(f"These are not the steps of a run: {' '.join(told)}")
    return trainer


def measure_steps(place: Place) -> Iterable[Line]:
    """Whole steps on few Gaussians and on the usual number;
    on the same ones, gsplat's steps with its appearance MLP."""
    for gaussians in STEP_SIZES:
        trainer = trainer_at(place, gaussians, EVERYTHING)
        camera, target = trainer.photos.target(0, 1)
        what = (
            f"a step on {trainer.gaussians.solid_count:,} Gaussians and {trainer.gaussians.sky_count:,} of sky, "
            f"{camera.width} x {camera.height}"
        )
        found = profiled(trainer.step, place)
        busy = sum(found.kernels.values())
        spent = f"{found.launches} launches, {found.waits} waits, {milliseconds(busy)} of the GPU"
        yield Line(f"{what}: launches and waits", "at most 1 wait", spent)
        works: dict[str, Callable[[], object]] = {"ours": trainer.step}
        if (other := peer.gsplat()) is not None:
            theirs = peer.PeerTrainer(other, trainer.gaussians.splats, len(trainer.photos))
            works["theirs"] = partial(theirs.step, 0, camera, target)
        medians = in_turns(place, works, STEPS)
        compared = (
            against(medians["ours"], medians["theirs"]) if other else f"{milliseconds(medians['ours'])}; {MISSING}"
        )
        yield Line(f"{what}, against gsplat's with an appearance MLP", "1.5x faster", compared)


def measure_paper(place: Place) -> Iterable[Line]:
    """Steps of the preset `paper` in the middle of its run, without density control, whose rounds are few."""
    settings = preset("paper")
    trainer = trainer_at(place, PAPER_GAUSSIANS, settings)

    def steps() -> None:
        for _ in range(PAPER_STEPS_TIMED):
            trainer.step()

    thousand = GpuStopwatch(place).repeat(steps, 0, 1)["whole"] * 1000 / PAPER_STEPS_TIMED
    hours = thousand * settings.steps / 1000 / 3600
    count = trainer.gaussians.solid_count
    found = f"{thousand:.1f} s a 1,000 steps on {count:,} Gaussians: {hours:.1f} h for {settings.steps:,}"
    yield Line("preset `paper`", "1.8 h on an RTX 4090 (the paper's)", found)


def measure_kernels(place: Place) -> Iterable[Line]:
    """Each kernel of the rasterizer: the bytes that it must move per second, as a share of a copy's;
    and what it takes of a multiprocessor."""
    (scene, camera), backend = scene_of(place), rasterizer.create("cuda", place.device.type)
    ceiling = copy_bandwidth(place)
    yield Line("a copy within the memory", "the ceiling", f"{ceiling / 1e9:.0f} GB/s")
    draw(backend, scene, camera)
    times = profiled(lambda: draw(backend, scene, camera), place).kernels
    for name, size in bytes_moved(scene, backend, camera).items():
        if name in times:
            found = (
                f"{milliseconds(times[name])}, {size / times[name] / 1e9:.0f} GB/s, "
                f"{size / times[name] / ceiling:.0%} of the copy's"
            )
            yield Line(f"{name}: {size / 1e6:.0f} MB", "", found)
    card = torch.cuda.get_device_properties(place.device) if place.device.type == "cuda" else None
    for name, registers, spilled, share in compiled(KERNEL_MODULES, card):
        yield Line(f"{name}, compiled", "", f"{registers} registers, {spilled} bytes spilled, occupancy {share:.0%}")


def bytes_moved(scene: Splats, backend: rasterizer.Rasterizer, camera: Camera) -> dict[str, int]:
    """The bytes that each kernel has to read and write for a picture and its gradients, if every pair were blended.

    A kernel far below the copy's bandwidth is bound by something else: blending, by its arithmetic.
    """
    rows = backend.visible(scene, camera).rows
    lists = prepare([tensor[rows] for tensor in scene.tensors().values()], None, camera).lists
    everyone, count, pairs, pixels = len(scene), len(rows), len(lists.owners), camera.width * camera.height
    parameters, footprints, slots = 4 * (3 + 4 + 3 + 1 + 3 * COEFFICIENTS), 4 * FOOTPRINT_COLUMNS, 4 * SLOT_COLUMNS
    return {
        "find_visible": everyone * (parameters + 8),
        "project": count * (parameters + 8 + footprints + 8),
        "list_tiles": count * (8 + 16 + 6 * 4) + pairs * (2 + 4),
        "blend_forward": pairs * (4 + 9 * 4) + pixels * 16,
        "blend_backward": pairs * (4 + 8 + 9 * 4 + slots) + pixels * 24,
        "add_up": pairs * slots + count * (24 + slots),
        "project_backward": count * (2 * parameters + footprints + slots + 8),
    }


MEASUREMENTS = {
    "picture": measure_picture,
    "baked": measure_baked,
    "steps": measure_steps,
    "paper": measure_paper,
    "kernels": measure_kernels,
}
