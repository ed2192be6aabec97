"""A look baked into many Gaussians, beside the matrix products that it cannot do without."""

import tempfile
import threading
from functools import partial
from pathlib import Path

import torch

from core import export
from core.appearance.model import AppearanceModel
from core.appearance.transfer_mlp import ROWS
from core.scene.splats import Splats
from core.system.threads import in_parallel
from samples.measurements.scenes import BAKED, COEFFICIENTS, DEGREE
from samples.measurements.stopwatch import Stopwatch

BAKED_GAUSSIANS, BAKES = 1_000_000, 15  # the first ones of two threads wait for memory that the machine has not used before


def measure_bake(scale: float) -> dict:
    """A scene in one look, and its .ply. The products are of blocks that stay in cache, into memory that is there."""
    count, stopwatch = round(BAKED_GAUSSIANS * scale), Stopwatch()
    splats = Splats(*map(torch.randn, [(count, 3), (count, 4), (count, 3), (count,), (count, COEFFICIENTS, 3)]))
    model, latents = AppearanceModel(BAKED, ()), torch.randn(count, BAKED.latent_size)
    hidden, output = (layers(model.mean_embedding) for layers in (model.sh_transfer.hidden_layers, model.sh_transfer.output_layer))
    weights = [hidden.feature_weight, hidden.place_weight, *hidden.hidden_weights, output.output_weight, output.skip_weight]
    factors = [(torch.randn(ROWS, weight.shape[1]), weight.detach().T) for weight in weights]
    own = threading.local()  # products: a thread writes into its own

    def multiply(begin: int, end: int) -> None:
        if not hasattr(own, "products"):
            own.products = [torch.empty(ROWS, weight.shape[1]) for _, weight in factors]
        for (inputs, weight), product in zip(factors, own.products):
            torch.mm(inputs, weight, out=product)

    def bake(path: Path) -> None:
        baked = model.bake(splats, model.mean_embedding, latents)
        stopwatch.lap("bake")
        export.write(path, baked, "benchmark")
        stopwatch.lap("write .ply")
        in_parallel(multiply, count, ROWS)
        stopwatch.lap("matrix products alone")

    with tempfile.TemporaryDirectory() as folder:
        parts = stopwatch.repeat(partial(bake, Path(folder) / "look.ply"), 1, BAKES)
    ratios = [round(parts["bake"]["median"][kind] / parts["matrix products alone"]["median"][kind], 2) for kind in (0, 1)]
    facts = {"gaussians": count, "sh_degree": DEGREE, "transfer_width": BAKED.transfer_width}
    return {"parts": parts, "facts": facts | {"times_the_products": ratios[0], "in_wall_time": ratios[1]}}
