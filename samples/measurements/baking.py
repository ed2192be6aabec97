"""How long it takes to bake a look into many Gaussians, and to compute only the matrix products that this needs."""

import tempfile
import threading
from functools import partial
from pathlib import Path

import torch

from core import export
from core.appearance.model import AppearanceModel
from core.appearance.sh_transfer import SHTransfer
from core.appearance.transfer_mlp import ROWS
from core.scene.splats import Splats
from core.system.threads import in_parallel
from samples.measurements.scenes import BAKED, COEFFICIENTS, DEGREE
from samples.measurements.stopwatch import CPU, WALL, Stopwatch

# So many that the first, which wait for memory not used before, do not move the median.
BAKED_GAUSSIANS, BAKES = 1_000_000, 15


def measure_bake(scale: float) -> dict:
    """A look baked, and written as a .ply. The products alone are of blocks that stay in the cache,
    written into memory that is allocated before."""
    count, stopwatch = round(BAKED_GAUSSIANS * scale), Stopwatch()
    splats = Splats(*map(torch.randn, [(count, 3), (count, 4), (count, 3), (count,), (count, COEFFICIENTS, 3)]))
    model, latents = AppearanceModel(BAKED, ()), torch.randn(count, BAKED.latent_size)
    transfer = model.sh_transfer
    assert isinstance(transfer, SHTransfer)  # the full appearance of BAKED has it
    hidden, output = transfer.hidden_layers(model.mean_embedding), transfer.output_layer(model.mean_embedding)
    weights = [
        hidden.feature_weight,
        hidden.position_weight,
        *hidden.hidden_weights,
        output.output_weight,
        output.skip_weight,
    ]
    factors = [(torch.randn(ROWS, weight.shape[1]), weight.detach().T) for weight in weights]
    own = threading.local()  # each thread's own products

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
    bake_s, products_s = (parts[part]["median"] for part in ("bake", "matrix products alone"))
    facts = {"gaussians": count, "sh_degree": DEGREE, "transfer_width": BAKED.transfer_width}
    facts |= {
        name: round(bake_s[kind] / products_s[kind], 2)
        for name, kind in (("times_the_products", CPU), ("in_wall_time", WALL))
    }
    return {"parts": parts, "facts": facts}
