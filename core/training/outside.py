"""The look of a photo from outside the collection."""

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.tone import band_means, taken_off, tone_between, toned
from core.training.trained import Run

VIEWS = 16  # training cameras that tell where in a photo the sky is
SHRUNK = 4  # times smaller than they were trained at
SHARES = 20  # of the tone that are tried, from little to all


@torch.no_grad()
def read_from_outside(trained: Run, picture: Float[Tensor, "3 h w"]) -> tuple[Float[Tensor, " e"], Float[Tensor, "2 3"] | None]:
    """(embedding, tone) of a photo ([0, 1], any size). Without a tone where the embedding is within what training photos reach.

    Else the tone is what turns the mean of the training views in the neutral look into the photo, and as much of it is taken off the photo
    as brings the embedding within reach: a small share of it, the same power of its gains, for a photo that is only
    just beyond. What does not come within reach by any share takes the one that brings it nearest, and is moved there.
    """
    model = trained.model
    embedding = model.embedding_from_outside(picture)
    if model.reach(embedding) <= 1:
        return embedding, None
    brought = _brought(trained)
    whole = tone_between(brought, band_means(picture))
    tones = [whole ** (share / SHARES) for share in range(1, SHARES + 1)]
    embeddings = [model.embedding_from_outside(taken_off(picture, tone, brought)) for tone in tones]
    reaches = [model.reach(embedding) for embedding in embeddings]
    nearest = min(range(SHARES), key=lambda share: (reaches[share], -share))  # all of it for a black photo, whatever is taken off
    chosen = next((share for share in range(SHARES) if reaches[share] <= 1), nearest)
    return model.within_reach(embeddings[chosen]), tones[chosen]


def _brought(trained: Run) -> Float[Tensor, "2 bands 3"]:
    """What the place and the sky bring into the bands of training views, in the mean, in the neutral look."""
    photos = trained.collection.split("train")
    neutral = trained.model.bake(trained.splats, trained.model.mean_embedding, trained.latents)
    alone = [toned(neutral, torch.tensor(gains)[:, None].expand(2, 3), trained.sky) for gains in ((1.0, 0.0), (0.0, 1.0))]
    brought = []
    for photo in photos[:: -(-len(photos) // VIEWS)]:
        camera = trained.camera(photo)
        camera = camera.resized(-(-camera.width // SHRUNK), -(-camera.height // SHRUNK))
        pictures = [trained.rasterizer.render(part, camera).image.permute(2, 0, 1) for part in alone]
        brought.append(torch.stack([band_means(picture.clamp(0, 1)) for picture in pictures]))
    return torch.stack(brought).mean(dim=0)
