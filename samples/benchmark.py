"""Time and memory of a training step, of the rasterizer and of a bake; scenes come from samples/plaza and fixed seeds.

    python samples/benchmark.py                         # everything: a minute or two on two idle cores
    python samples/benchmark.py bake --json bake.json   # one measurement, and its numbers as a file

CPU time is that of all threads. Each measurement has a process of its own, so the peak memory is its own too. Kernels
are compiled in the warm-up, and the compiler takes memory: run it twice to read the memory.
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
import rich
import torch
from rich.table import Table

import core.export
import core.rasterizer
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
POINT_SPREAD = 0.015  # scene units; about as far apart as the sample's SfM points
GARDEN_GAUSSIANS, GARDEN_SIZE_PX, RENDERS = 140_000, (648, 420), 15
BAKED_GAUSSIANS, BAKES = 1_000_000, 3
DEGREE, COEFFICIENTS = 3, 16  # of garden and bake; the steps have the default degree
REST = "everything else"


class Stopwatch:
    """Everything since the last lap goes to the part named at its end. laps: part -> (CPU, wall) seconds."""

    def start(self) -> None:
        self.laps, self.last = {}, np.array([time.process_time(), time.perf_counter()])

    def lap(self, part: str) -> None:
        now = np.array([time.process_time(), time.perf_counter()])
        self.laps[part] = self.laps.get(part, 0) + now - self.last
        self.last = now

    def repeat(self, work, warm_up: int, times: int) -> dict:
        """Call work() `warm_up + times` times: part -> {"cpu_s", "wall_s"} -> figures of the last `times`."""
        runs = []
        for _ in range(warm_up + times):
            self.start()
            work()
            self.lap(REST)
            runs.append({"whole": sum(self.laps.values())} | self.laps)
        parts = {part: np.array([run[part] for run in runs[warm_up:]]) for part in runs[-1]}
        return {part: dict(zip(("cpu_s", "wall_s"), map(figures, laps.T))) for part, laps in parts.items()}


def figures(seconds: np.ndarray) -> dict[str, float]:
    """low and high are quartiles; the mean alone sees what only some steps do."""
    low, median, high = np.quantile(seconds, (0.25, 0.5, 0.75)).tolist()
    return {"median": median, "low": low, "high": high, "mean": float(seconds.mean())}


def measure_step(scale: float, appearance: str, transients: str) -> dict:
    """Whole steps of a Trainer in the middle of its run: full size, masks at work; density control is not in them."""
    collection, stopwatch = plaza(scale), Stopwatch()
    size = {"resolution": 1, "max_gaussians": 2 * len(collection.points)}  # a run starts with half of what it may have
    settings = Settings(**size, appearance=appearance, transients=transients)
    trainer = Trainer(collection, settings, Path())
    trainer.done = settings.steps // 2
    watch_step(trainer, stopwatch)
    parts = stopwatch.repeat(trainer.step, math.ceil(STEP_WARM_UP * scale), math.ceil(STEPS * scale))
    gaussians, cameras = trainer.gaussians, [picture.camera for picture in trainer.pictures.pictures]
    visible = [len(trainer.rasterizer.visible(gaussians.splats, camera)) for camera in cameras]
    facts = {"gaussians": gaussians.solid, "sky": gaussians.sky, "visible": f"{min(visible)} to {max(visible)}"}
    facts |= {"visible mean": round(sum(visible) / len(visible)), "sh_degree": settings.sh_degree}
    return {"parts": parts, "facts": facts | {"size_px": f"{cameras[0].width} x {cameras[0].height}"}}


def plaza(scale: float) -> Collection:
    """The sample's wide photos, seen at another size, and points strewn around its SfM points."""
    sample = load_collection(Path(__file__).parent / "plaza")
    size = [round(side * scale**0.5) for side in STEP_SIZE_PX]
    wide = [photo for photo in sample.split("train") if photo.camera.width > photo.camera.height][:STEP_PHOTOS]
    photos = tuple(replace(photo, camera=photo.camera.resized(*size)) for photo in wide)  # decoded to fit the camera
    random = np.random.default_rng(0)
    near = random.integers(len(sample.points), size=round(STEP_GAUSSIANS * scale))
    points = sample.points[near] + POINT_SPREAD * random.normal(size=(len(near), 3))
    return replace(sample, photos=photos, points=points, point_colours=sample.point_colours[near])


def watch_step(trainer: Trainer, stopwatch: Stopwatch) -> None:
    """Turn the calls that `trainer.step` makes into laps.

    The backward pass is one call, from the regularisers to the SH transfer. A hook on a tensor fires in it when the
    tensor's gradient is complete: the backward pass of all that was made from the tensor is over.
    """
    outermost = True

    def watch(owner, method: str, part: str, hooked=None, part_behind: str = "", before: str = REST) -> None:
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

    watch(trainer.pictures, "target", "visible, gather")
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
    watch(trainer, "_remember", "mask, regularisers")


def measure_rasterizer(scale: float) -> dict:
    """A picture of the garden and its gradients, as training asks for them."""
    width, height = (round(side * scale**0.5) for side in GARDEN_SIZE_PX)
    axes = np.array([(1, 0, 0), (0, -0.35, -0.94), (0, 0.94, -0.35)])  # over the table, some 20 degrees down
    camera = Camera(axes, np.array([0, -1.6, 0.8]), 1.1 * width, 1.1 * width, width / 2, height / 2, width, height)
    scene, rasterizer, stopwatch = garden(round(GARDEN_GAUSSIANS * scale)), core.rasterizer.create("cpu"), Stopwatch()

    def render() -> None:
        rows = rasterizer.visible(scene, camera)
        leaves = scene[rows].map(torch.Tensor.requires_grad_)
        stopwatch.lap("visible, gather")
        image = rasterizer.render(leaves, camera, probe=torch.zeros(len(rows), 2, requires_grad=True)).image
        stopwatch.lap("rasterizer forward")
        image.backward(torch.ones_like(image))
        stopwatch.lap("rasterizer backward")

    facts = {"gaussians": len(scene), "visible": len(rasterizer.visible(scene, camera)), "sh_degree": DEGREE}
    return {"parts": stopwatch.repeat(render, 2, RENDERS), "facts": facts | {"size_px": f"{width} x {height}"}}


def garden(count: int) -> Splats:
    """A table, a lawn and a hedge around them, z up: Gaussians in clumps, finer in the middle, most of them opaque."""
    random, clumps = np.random.default_rng(0), max(count // 100, 3)
    kind, share, angle = random.choice(3, clumps), random.random(clumps), random.uniform(0, 2 * np.pi, clumps)
    distance = np.choose(kind, [0.3 * share, 0.3 + 2.2 * share, 3.0])
    height = np.choose(kind, [0.35, 0.0, 1.5]) * random.random(clumps)
    centres = np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=1)
    clump = random.integers(clumps, size=count)
    width = 0.02 + 0.05 * distance[clump, None]
    means = centres[clump] + width * random.normal(size=(count, 3)) * (1, 1, 0.5)
    log_scales = np.log(0.12 * width) + random.normal(size=(count, 3)) * (0.5, 0.5, 0.8)
    quaternions, sh = random.normal(size=(count, 4)), random.normal(size=(count, COEFFICIENTS, 3)) * 0.05
    parts = means, quaternions, log_scales, random.normal(1.0, 2.0, count), sh
    return Splats(*(torch.from_numpy(part).float() for part in parts))


def measure_bake(scale: float) -> dict:
    """A scene in one look, and its .ply; beside it the matrix products that the SH transfer cannot do without."""
    count, stopwatch = round(BAKED_GAUSSIANS * scale), Stopwatch()
    model = AppearanceModel(Settings(sh_degree=DEGREE), ())
    splats = Splats(*map(torch.randn, [(count, 3), (count, 4), (count, 3), (count,), (count, COEFFICIENTS, 3)]))
    embedding = torch.randn_like(model.mean_embedding)
    layers = [(torch.ones(ROWS, layer.in_features), layer.weight.T) for layer in model.sh_transfer.layers]

    def multiply(begin: int, end: int) -> None:
        for rows, weight in layers:
            torch.mm(rows, weight)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "look.ply"

        def bake() -> None:
            baked = model.bake(splats, embedding)
            stopwatch.lap("bake")
            core.export.write(path, baked, "benchmark")
            stopwatch.lap("write .ply")

        parts = stopwatch.repeat(bake, 1, BAKES)
        facts = {"gaussians": count, "sh_degree": DEGREE, "file_mb": round(path.stat().st_size / 1e6, 1)}
    products = stopwatch.repeat(lambda: in_parallel(multiply, count, ROWS), 1, BAKES)
    return {"parts": parts | {"matrix products alone": products["whole"]}, "facts": facts}


MEASUREMENTS = {
    "step": partial(measure_step, appearance="full", transients="on"),
    "plain-step": partial(measure_step, appearance="off", transients="off"),
    "rasterizer": measure_rasterizer,
    "bake": measure_bake,
}


def measure(name: str, scale: float, threads: int) -> dict:
    """A measurement and the most memory that this process has held by its end."""
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    measured = MEASUREMENTS[name](scale)
    return measured | {"peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6}


def machine(threads: int) -> dict:
    """Where the numbers come from."""
    lines = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    facts = {"cpu": lines[0].split(": ")[1] if lines else "unknown", "cores": os.cpu_count(), "threads": threads}
    facts |= {"load": round(os.getloadavg()[0], 2), "python": sys.version.split()[0]}
    return facts | {name: version(name) for name in ("torch", "numba", "numpy")}


def table(name: str, measured: dict) -> Table:
    """Milliseconds, a line a part."""
    facts = ", ".join(f"{fact} {value}" for fact, value in measured["facts"].items())
    made = Table("ms", title=f"{name}: {measured['peak_memory_mb']:.0f} MB", caption=facts)
    for column in ("CPU median", "quartiles", "mean", "wall median"):
        made.add_column(column, justify="right", no_wrap=True)
    for part, spent in measured["parts"].items():
        low, median, high, mean = (f"{1e3 * spent['cpu_s'][key]:.1f}" for key in ("low", "median", "high", "mean"))
        made.add_row(part, median, f"{low} - {high}", mean, f"{1e3 * spent['wall_s']['median']:.1f}")
    return made


@click.command()
@click.argument("what", nargs=-1, type=click.Choice(list(MEASUREMENTS)))
@click.option("--json", "file", type=click.Path(path_type=Path), help="Write the numbers into this file as well.")
@click.option("--threads", default=torch.get_num_threads(), show_default=True)
@click.option("--scale", default=1.0, show_default=True, help="Share of all sizes; below 1 only to try it out.")
def main(what: tuple[str, ...], file: Path | None, threads: int, scale: float) -> None:
    """Measure time and memory of what is named, or of everything."""
    result = {"machine": machine(threads), "scale": scale, "measurements": {}}
    rich.print(result["machine"])
    for name in what or MEASUREMENTS:
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # a fork would begin with this process's memory
            result["measurements"][name] = pool.submit(measure, name, scale, threads).result()
        rich.print(table(name, result["measurements"][name]))
    if file:
        file.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
