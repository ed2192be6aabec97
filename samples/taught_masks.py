"""How well the mask network finds passers-by if it is trained with the true masks, which wegs never sees.

    python samples/taught_masks.py samples/plaza

The same layers (Enc1 and UNet, on their own) learn the true mask of every training photo by binary cross-entropy, with
photos mirrored and brightened at random. How well they then mask held-out photos shows how far labels alone would lead;
it is not a strict bound. Prints the mean mask IoU as `wegs eval` measures it, and for comparison that of a mask that
looks at nothing.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from samples.measurements.begin import begin

begin()

import click
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from core.appearance.encoder import PlainMask, shrink
from core.config import Settings
from core.data import load_collection
from core.data.collection import Collection
from core.data.photos.pixels import read_pixels
from core.errors import BadInput
from core.evaluation.metrics import mask_iou
from core.evaluation.truth import load_truth
from core.system.threads import one_torch_thread
from samples.measurements import arguments
from samples.measurements.seeds import cell
from wegs_cli.main import OneLineErrors
from wegs_cli.terminal import Terminal

RATE, DECAY = 2e-3, 0.1  # of Adam, at the first step and by the last
BRIGHTER = 0.2  # spread (log) of a channel's random gain
LOWEST_QUARTER = torch.tensor([[[1.0], [1.0], [1.0], [0.0]]])  # a mask that hides it
CERTAIN = 1e-4  # a prediction is kept this far from 0 and 1, whose logarithms the loss takes


class Example(NamedTuple):
    """A photo, squeezed into the encoder's square, and where it is static."""

    picture: Float[Tensor, "3 s s"]
    static: Bool[Tensor, "h w"]


@click.command(cls=OneLineErrors)
@arguments.scene
@arguments.steps(6000)
@arguments.seeds(3, "Networks to teach.")
def main(scene: Path, steps: int, seeds: int) -> None:
    """Teach the mask network with the true masks of SCENE, and measure it on its held-out photos."""
    collection = load_collection(scene)
    train, test = (examples(collection, split) for split in ("train", "test"))
    if not train or not test:
        raise BadInput(
            f"{scene} knows no masks of training and held-out photos.", "Use one that samples/make_plaza.py made."
        )
    with Terminal() as terminal, one_torch_thread():
        overlaps = [mean_iou(taught(train, steps, seed, terminal), test) for seed in range(seeds)]
    click.echo(f"{len(train)} training photos, {len(test)} held out: mask IoU {cell(overlaps, '{:.2f}')}")
    click.echo(f"A mask that hides the lowest quarter of every photo: {mean_iou(lambda _: LOWEST_QUARTER, test):.2f}")


def examples(collection: Collection, split: str) -> list[Example]:
    """The photos of a split whose true masks are known."""
    found = []
    for photo in collection.split(split):
        static = load_truth(collection.root, photo.name, photo.camera.width, photo.camera.height).static
        if static is not None:
            picture = torch.from_numpy(read_pixels(photo.path)).permute(2, 0, 1).float() / 255
            found.append(Example(shrink(picture, Settings().encoder_side_px), static))
    return found


def taught(train: list[Example], steps: int, seed: int, terminal: Terminal) -> PlainMask:
    """The mask network after `steps` of the examples, drawn at random."""
    torch.manual_seed(seed)
    network = PlainMask()
    optimizer = torch.optim.Adam(network.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, DECAY ** (1 / steps))
    for step in range(steps):
        picture, static = train[int(torch.randint(len(train), ()))]
        picture = (picture * torch.exp(BRIGHTER * torch.randn(3, 1, 1))).clamp(max=1)
        mirrored = bool(torch.rand(()) < 0.5)
        mask = network(picture.flip(-1) if mirrored else picture).clamp(CERTAIN, 1 - CERTAIN)
        truth = F.interpolate(static[None, None].float(), size=mask.shape[1:], mode="area")[0]
        optimizer.zero_grad()
        F.binary_cross_entropy(mask, truth.flip(-1) if mirrored else truth).backward()
        optimizer.step()
        schedule.step()
        terminal.progress(f"Seed {seed}", step + 1, steps)
    return network


@torch.no_grad()
def mean_iou(network: Callable[[Tensor], Tensor], test: list[Example]) -> float:
    """The mean IoU of the masks, (1, h, w), that the network makes of these photos."""
    overlaps = [mask_iou(network(picture)[0], static) for picture, static in test]
    return sum(overlaps) / len(overlaps)


if __name__ == "__main__":
    main()
