"""Time and memory of a training step, of the rasterizer and of a bake; scenes come from samples/plaza and fixed seeds.

    python samples/benchmark.py                                       # everything: a minute or two on two idle cores
    OMP_NUM_THREADS=1 python samples/benchmark.py step --json step.json   # one measurement, one thread, and a file

CPU time is that of all threads. A measurement has a process of its own, so its peak memory is its own too. Kernels are
compiled in the warm-up, and the compiler takes memory: run it twice to read the memory.
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does, before torch is imported
sys.path.insert(0, str(Path(__file__).parent.parent))  # the engine beside this script, installed or not

import json
import math
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context

import click
import numpy as np
import rich.table
import torch

from core import __version__, export, rasterizer
from core.appearance.model import AppearanceModel
from core.appearance.transfer_kernel import ROWS
from core.config import Settings
from core.data import load_collection
from core.data.collection import Collection
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.threads import in_parallel
from core.training.trainer import Trainer

STEP_GAUSSIANS, STEP_SIZE_PX, STEP_PHOTOS = 30_000, (324, 210), 10
STEP_WARM_UP, STEPS = 100, 60  # the first steps turn the haze of a fresh scene into surfaces
GARDEN_GAUSSIANS, GARDEN_SIZE_PX, RENDERS = 140_000, (648, 420), 15
BAKED_GAUSSIANS, BAKES, DEGREE, COEFFICIENTS = 1_000_000, 3, 3, 16  # garden's degree too; steps have the default one


class Stopwatch:
    """Everything since the last lap goes to the part named at its end. laps: part -> (CPU, wall) seconds."""

    def start(self) -> None:
        self.laps, self.last = {}, np.array([time.process_time(), time.perf_counter()])

    def lap(self, part: str) -> None:
        now = np.array([time.process_time(), time.perf_counter()])
        self.laps[part] = self.laps.get(part, 0) + now - self.last
        self.last = now

    def repeat(self, work, warm_up: int, times: int) -> dict:
        """Call work() often: part -> median, quartiles (low, high) and mean of the last `times`, as [CPU s, wall s]."""
        runs = []
        for _ in range(warm_up + times):
            self.start()
            work()
            self.lap("everything else")
            runs.append({"whole": sum(self.laps.values())} | self.laps)
        figures = {}
        for part in runs[-1]:
            laps = np.array([run[part] for run in runs[warm_up:]])
            low, median, high = np.quantile(laps, (0.25, 0.5, 0.75), axis=0).tolist()
            figures[part] = {"median": median, "low": low, "high": high, "mean": laps.mean(axis=0).tolist()}
        return figures


def measure_step(scale: float, appearance: str, transients: str) -> dict:
    """Whole steps of a Trainer in the middle of its run: full size, masks at work; density control is not in them."""
    stopwatch, most = Stopwatch(), round(2 * STEP_GAUSSIANS * scale)  # a run starts with half of what it may grow to
    settings = Settings(resolution=1, max_gaussians=most, appearance=appearance, transients=transients, sh_degree=1)
    trainer = Trainer(plaza(scale), settings, Path())
    trainer.done = settings.steps // 2
    watch_step(trainer, stopwatch)
    parts = stopwatch.repeat(trainer.step, math.ceil(STEP_WARM_UP * scale), math.ceil(STEPS * scale))
    cameras = [picture.camera for picture in trainer.pictures.pictures]
    visible = [len(trainer.rasterizer.visible(trainer.gaussians.splats, camera)) for camera in cameras]
    facts = {"gaussians": trainer.gaussians.solid, "sky": trainer.gaussians.sky, "sh_degree": settings.sh_degree}
    facts |= {"visible": round(sum(visible) / len(visible)), "from": min(visible), "to": max(visible)}
    return {"parts": parts, "facts": facts | {"size_px": f"{cameras[0].width} x {cameras[0].height}"}}


def plaza(scale: float) -> Collection:
    """The sample's wide photos, seen at another size, and points strewn around its SfM points."""
    sample = load_collection(Path(__file__).parent / "plaza")
    size = [round(side * scale**0.5) for side in STEP_SIZE_PX]
    wide = [photo for photo in sample.split("train") if photo.camera.width > photo.camera.height][:STEP_PHOTOS]
    photos = tuple(replace(photo, camera=photo.camera.resized(*size)) for photo in wide)  # decoded to fit the camera
    random = np.random.default_rng(0)
    near = random.integers(len(sample.points), size=round(STEP_GAUSSIANS * scale))
    points = sample.points[near] + 0.015 * random.normal(size=(len(near), 3))  # about as far as they lie apart
    return replace(sample, photos=photos, points=points, point_colours=sample.point_colours[near])


def watch_step(trainer: Trainer, stopwatch: Stopwatch) -> None:
    """Turn the calls that `trainer.step` makes into laps.

    The backward pass is one call; a hook on a tensor fires in it when all that was made from the tensor is through.
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
            if hooked is not None:
                hooked(result).register_hook(lambda gradient: stopwatch.lap(part_behind))
            return result

        setattr(owner, method, watched)

    watch(trainer.rasterizer, "visible", "visible, gather")
    watch(trainer.gaussians, "leaves", "visible, gather")
    watch(trainer.model, "look", "encoder forward")
    watch(trainer.model, "transfer", "SH transfer forward", lambda result: result[0], "rasterizer backward")
    watch(trainer.rasterizer, "render", "rasterizer forward", lambda result: result.image, "picture loss")
    watch(trainer, "_picture_loss", "picture loss", lambda loss: loss, "mask, regularisers")
    watch(trainer, "_mask_loss", "mask, regularisers")
    watch(trainer, "_regularisers", "mask, regularisers")
    watch(trainer, "_teach_encoder", "encoder backward", before="SH transfer backward")
    watch(trainer, "_update", "Adam")


def measure_rasterizer(scale: float) -> dict:
    """A picture of the garden and its gradients, as training asks for them."""
    width, height = (round(side * scale**0.5) for side in GARDEN_SIZE_PX)
    axes = np.array([(1, 0, 0), (0, -0.28, -0.96), (0, 0.96, -0.28)])  # over the table, 16 degrees down
    camera = Camera(axes, np.array([0, -1.6, 0.8]), 1.1 * width, 1.1 * width, width / 2, height / 2, width, height)
    scene, backend, stopwatch = garden(round(GARDEN_GAUSSIANS * scale)), rasterizer.create("cpu"), Stopwatch()

    def render() -> None:
        rows = backend.visible(scene, camera)
        leaves = scene[rows].map(torch.Tensor.requires_grad_)
        stopwatch.lap("visible, gather")
        image = backend.render(leaves, camera, probe=torch.zeros(len(rows), 2, requires_grad=True)).image
        stopwatch.lap("rasterizer forward")
        image.backward(torch.ones_like(image))
        stopwatch.lap("rasterizer backward")

    facts = {"gaussians": len(scene), "visible": len(backend.visible(scene, camera)), "sh_degree": DEGREE}
    return {"parts": stopwatch.repeat(render, 2, RENDERS), "facts": facts | {"size_px": f"{width} x {height}"}}


def garden(count: int) -> Splats:
    """A table, a lawn and a hedge around them, z up: Gaussians in clumps, finer in the middle, most of them opaque."""
    random, clumps = np.random.default_rng(0), max(count // 100, 3)
    distance, angle = random.uniform(0, 3, clumps), random.uniform(0, 2 * np.pi, clumps)
    height = random.random(clumps) * np.select([distance < 0.4, distance > 2.6], [0.35, 1.5])
    centres = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=1)
    clump = random.integers(clumps, size=count)
    width = 0.02 + 0.05 * distance[clump, None]
    means = centres[clump] + width * random.normal(size=(count, 3)) * (1, 1, 0.5)
    log_scales = np.log(0.12 * width) + random.normal(size=(count, 3)) * (0.5, 0.5, 0.8)
    quaternions, sh = random.normal(size=(count, 4)), random.normal(size=(count, COEFFICIENTS, 3)) * 0.05
    parts = means, quaternions, log_scales, random.normal(1, 2, count), sh
    return Splats(*(torch.from_numpy(part).float() for part in parts))


def measure_bake(scale: float) -> dict:
    """A scene in one look, and its .ply; beside it the matrix products that the SH transfer cannot do without."""
    count, stopwatch = round(BAKED_GAUSSIANS * scale), Stopwatch()
    splats = Splats(*map(torch.randn, [(count, 3), (count, 4), (count, 3), (count,), (count, COEFFICIENTS, 3)]))
    model = AppearanceModel(Settings().decided("full", "on", DEGREE), ())

    def bake(path: Path) -> None:
        baked = model.bake(splats, model.mean_embedding)
        stopwatch.lap("bake")
        export.write(path, baked, "benchmark")
        stopwatch.lap("write .ply")

    _, layers = model.sh_transfer.inputs(splats.sh[:1], model.mean_embedding)
    weights = [layers.learned_weight, layers.place_weight, *layers.hidden_weights, layers.output_weight, layers.skip_weight]
    products = [(torch.ones(ROWS, weight.shape[1]), weight.detach().T) for weight in weights]
    with tempfile.TemporaryDirectory() as folder:
        parts = stopwatch.repeat(partial(bake, Path(folder) / "look.ply"), 1, BAKES)
    multiply = partial(in_parallel, lambda begin, end: [torch.mm(*product) for product in products], count, ROWS)
    parts["matrix products alone"] = stopwatch.repeat(multiply, 1, BAKES)["whole"]
    return {"parts": parts, "facts": {"gaussians": count, "sh_degree": DEGREE}}


MEASUREMENTS = {
    "step": partial(measure_step, appearance="full", transients="on"),
    "plain-step": partial(measure_step, appearance="off", transients="off"),
    "rasterizer": measure_rasterizer,
    "bake": measure_bake,
}


def measure(name: str, scale: float) -> dict:
    """A measurement and the most memory that this process has held by its end."""
    torch.manual_seed(0)
    measured = MEASUREMENTS[name](scale)
    return measured | {"peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6}


def machine() -> dict:
    """Where the numbers come from."""
    lines = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    facts = {"cpu": lines[0].split(": ")[1] if lines else "unknown", "cores": os.cpu_count()}
    facts |= {"threads": torch.get_num_threads(), "load": round(os.getloadavg()[0], 2), "wegs": __version__}
    return facts | {"python": sys.version.split()[0]} | {name: version(name) for name in ("torch", "numba", "numpy")}


def table(name: str, measured: dict) -> rich.table.Table:
    """Milliseconds, a line a part."""
    facts = ", ".join(f"{fact} {value}" for fact, value in measured["facts"].items())
    made = rich.table.Table("ms", title=f"{name}: peak memory {measured['peak_memory_mb']:.0f} MB", caption=facts)
    for column in ("CPU median", "quartiles", "mean", "wall median"):
        made.add_column(column, justify="right", no_wrap=True)
    for part, spent in measured["parts"].items():
        low, median, high, mean = (f"{1e3 * spent[figure][0]:.1f}" for figure in ("low", "median", "high", "mean"))
        made.add_row(part, median, f"{low} - {high}", mean, f"{1e3 * spent['median'][1]:.1f}")
    return made


@click.command()
@click.argument("what", nargs=-1, type=click.Choice(list(MEASUREMENTS)))
@click.option("--json", "file", type=click.Path(path_type=Path), help="Write the numbers into this file as well.")
@click.option("--scale", default=1.0, show_default=True, help="Share of all sizes; below 1 only to try it out.")
def main(what: tuple[str, ...], file: Path | None, scale: float) -> None:
    """Measure time and memory of what is named, or of everything."""
    result = {"machine": machine(), "scale": scale, "seconds": ["CPU", "wall"], "measurements": {}}
    rich.print(result["machine"])
    for name in what or MEASUREMENTS:
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # a fork would begin with this process's memory
            result["measurements"][name] = pool.submit(measure, name, scale).result()
        rich.print(table(name, result["measurements"][name]))
    if file:
        file.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
