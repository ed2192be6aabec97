"""The rasterizer: alone, beside one in plain torch, and as scenes and pictures grow."""

from collections.abc import Callable
from functools import partial

import numpy as np
import torch

from core import rasterizer
from core.scene.camera import Camera
from core.scene.splats import Splats
from core.system.threads import one_torch_thread
from core.training.gaussians.chosen_rows import chosen_rows
from samples.measurements.scenes import DEGREE, GARDEN_GAUSSIANS, GARDEN_SIZE_PX, garden, garden_camera
from samples.measurements.stopwatch import CPU, WALL, Stopwatch, forget_peak, now, peak_memory

RENDERS, GROWTH_RENDERS = 15, 5
TILES = 18, 12  # of the garden's picture, for plain torch
TILES_MEASURED = 12
GROWTH_COLUMNS = ["Gaussians", "visible", "pixels", "CPU ms", "low", "high", "wall ms", "peak MB"]
GROWING_GAUSSIANS = 10_000, 30_000, 100_000, 300_000, 1_000_000
GROWING_PIXELS = 250_000, 500_000, 1_000_000, 2_000_000, 4_000_000


def garden_of(scale: float) -> tuple[Splats, Camera]:
    """The garden and its camera, with that share of the usual Gaussians and pixels."""
    return garden(round(GARDEN_GAUSSIANS * scale)), usual_camera(scale)


def usual_camera(scale: float) -> Camera:
    return garden_camera(*(round(side * scale**0.5) for side in GARDEN_SIZE_PX))


def draw(
    backend: rasterizer.Rasterizer, scene: Splats, camera: Camera, lap: Callable[[str], None] = lambda part: None
) -> tuple:
    """The picture and the gradient of every tensor for a gradient of ones, as training asks for them.
    lap: told each part that is done."""
    visible = backend.visible(scene, camera)
    rows = visible.rows
    leaves = Splats(**{name: copy.requires_grad_() for name, copy in chosen_rows(scene.tensors(), rows).items()})
    lap("visible, lists, gather")
    image = backend.render(
        leaves, camera, probe=torch.zeros(len(rows), 2, requires_grad=True, device=rows.device), known=visible.known
    )
    lap("rasterizer forward")
    image.backward(torch.ones_like(image))
    lap("rasterizer backward")
    return image.detach(), [leaf.grad for leaf in leaves.tensors().values()]


def measure_rasterizer(scale: float) -> dict:
    """A picture of the garden and its gradients."""
    (scene, camera), backend, stopwatch = garden_of(scale), rasterizer.create("cpu"), Stopwatch()
    parts = stopwatch.repeat(lambda: draw(backend, scene, camera, stopwatch.lap), 2, RENDERS)
    facts = {"gaussians": len(scene), "visible": len(backend.visible(scene, camera).rows), "sh_degree": DEGREE}
    return {"parts": parts, "facts": facts | {"size_px": f"{camera.width} x {camera.height}"}}


def measure_plain_torch(scale: float) -> dict:
    """The same picture by both backends, a sample of tiles for the one in plain torch.

    The reference looks at every Gaussian in every pixel. So it gets one tile at a time and only the Gaussians that
    touch it, which are found beforehand and not timed: as good as plain torch can be without a kernel. It runs on one
    thread; on two, its CPU time would be larger.
    """
    (scene, camera), fast, plain = garden_of(scale), rasterizer.create("cpu"), rasterizer.create("reference")
    parts = {"cpu": Stopwatch().repeat(partial(draw, fast, scene, camera), 2, RENDERS)["whole"]}
    columns, rows = (min(count, side) for count, side in zip(TILES, (camera.width, camera.height)))
    count = columns * rows
    spent, picture_error, gradient_error = [], 0.0, 0.0
    measured = np.linspace(0, count - 1, min(TILES_MEASURED, count)).round().astype(int)
    draw(plain, scene[:100], tile_of(camera, columns, rows, 0))  # torch loads what it needs
    for tile in measured:
        view = tile_of(camera, columns, rows, int(tile))
        touching = scene[fast.visible(scene, view).rows]
        with one_torch_thread():
            start = now()
            image, gradients = draw(plain, touching, view)
            spent.append(now() - start)
        fast_image, fast_gradients = draw(fast, touching, view)
        picture_error = max(picture_error, float((image - fast_image).abs().max()))
        for gradient, fast_gradient in zip(gradients, fast_gradients):
            error = float((gradient - fast_gradient).norm() / gradient.norm().clamp_min(1e-12))
            gradient_error = max(gradient_error, error)
    whole = np.mean(spent, axis=0) * count
    low, high = (np.quantile(spent, share, axis=0) * count for share in (0.25, 0.75))
    figures = {"median": whole, "low": low, "high": high, "mean": whole}
    parts["plain torch"] = {name: values.tolist() for name, values in figures.items()}
    facts = {"gaussians": len(scene), "tiles": f"{len(spent)} of {count}, times {count / len(spent):.0f}"}
    facts["times"] = round(whole[CPU] / parts["cpu"]["median"][CPU], 1)
    facts |= {"picture_error": f"{picture_error:.1e}", "gradient_error": f"{gradient_error:.1e}"}
    return {"parts": parts, "facts": facts}


def tile_of(camera: Camera, columns: int, rows: int, tile: int) -> Camera:
    """One tile of a picture as a picture of its own; tiles are numbered row by row."""
    row, column = divmod(tile, columns)
    left, right = (camera.width * edge // columns for edge in (column, column + 1))
    top, bottom = (camera.height * edge // rows for edge in (row, row + 1))
    return camera.cropped(left, top, right - left, bottom - top)


def measure_growth_in_gaussians(scale: float) -> dict:
    """Pictures of the garden's usual size, of ever more Gaussians."""
    camera = usual_camera(scale)
    return growth("Gaussians", [(round(count * scale), camera) for count in GROWING_GAUSSIANS])


def measure_growth_in_pixels(scale: float) -> dict:
    """The same garden, in ever larger pictures of the same shape."""
    aspect, cases = GARDEN_SIZE_PX[0] / GARDEN_SIZE_PX[1], []
    for pixels in GROWING_PIXELS:
        width, height = (round((pixels * scale * ratio) ** 0.5) for ratio in (aspect, 1 / aspect))
        cases.append((round(GARDEN_GAUSSIANS * scale), garden_camera(width, height)))
    return growth("pixels", cases)


def growth(what: str, cases: list[tuple[int, Camera]]) -> dict:
    """CPU time and peak memory of each case (Gaussians, camera), and how both grow.
    what: the size that grows, one of GROWTH_COLUMNS.

    exponent: the slope of log time over log size by least squares, over all sizes and over the larger half, where
    constant costs count less. bytes: the slope of peak memory over size.
    """
    backend, rows = rasterizer.create("cpu"), []
    for number, (count, camera) in enumerate(cases):
        scene = garden(count)
        if number == 0:
            draw(backend, scene, camera)  # kernels are compiled, which takes memory
        forget_peak()
        seconds = Stopwatch().repeat(partial(draw, backend, scene, camera), 1, GROWTH_RENDERS)["whole"]
        visible, pixels = len(backend.visible(scene, camera).rows), camera.width * camera.height
        times = [1e3 * seconds[figure][CPU] for figure in ("median", "low", "high")]
        rows.append([count, visible, pixels, *times, 1e3 * seconds["median"][WALL], peak_memory() / 1e6])
    table = dict(zip(GROWTH_COLUMNS, np.array(rows, float).T, strict=True))
    sizes, times, peaks = table[what], table["CPU ms"], table["peak MB"]
    half = len(rows) // 2
    facts = {
        "exponent": round(slope(np.log(sizes), np.log(times)), 2),
        "exponent_of_larger": round(slope(np.log(sizes[half:]), np.log(times[half:])), 2),
        f"bytes_a_{what.lower()[:-1]}": round(slope(sizes, peaks * 1e6)),
    }
    return {"parts": {}, "facts": facts, "series": {"columns": GROWTH_COLUMNS, "rows": rows}}


def slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x, y, 1)[0])
