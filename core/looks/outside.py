"""The look of a photo from outside the collection."""

from math import log

import torch
from jaxtyping import Float
from torch import Tensor

from core.appearance.colouring import Colouring
from core.appearance.encoder import shrink
from core.appearance.tone import band_means, taken_off, tone_between, toned
from core.data.collection import spread_over
from core.looks.trained import TrainedRun, bake, neutral_look

VIEWS = 16  # training cameras, which show where in a photo the sky usually is
SHRUNK = 4  # how many times smaller their pictures are than in training
TRIES = 20  # shares of the tone that are tried, from 1/20 to all of it
PLAIN = 1.1  # a gain, or a channel's gain over the mean gain, that is worth mentioning
TINTS = "redder", "greener", "bluer"


@torch.no_grad()
def read_from_outside(trained: TrainedRun, picture: Float[Tensor, "3 h w"]) -> Colouring:
    """The look of a photo ([0, 1], any size): its embedding and, if that lies outside the known range, a tone.

    The whole tone would turn the mean of the training views, in the neutral look, into the photo. Of its shares (powers
    of its gains), the look gets the smallest that brings the embedding into the range once it is removed from the
    photo. If none does, it gets the share that brings the embedding nearest, which is then moved into the range. If
    transparent pixels are empty space, the embedding is moved without a tone: what such a photo shows around the object
    is not the run's sky.
    """
    model, known_range, picture = trained.model, trained.known_range, shrink(picture, trained.settings.encoder_side_px)
    embedding = model.embedding_from_outside(picture)
    if trained.settings.transparent_is_empty or known_range.distance(embedding) <= 1:
        return Colouring(known_range.nearest(embedding))
    layers = tone_layers(trained)
    whole = tone_between(layers, band_means(picture))
    tones = [whole ** (part / TRIES) for part in range(1, TRIES + 1)]
    embeddings = [model.embedding_from_outside(taken_off(picture, tone, layers)) for tone in tones]
    distances = [known_range.distance(embedding) for embedding in embeddings]
    # Of equally near ones the largest: for a black photo, which no share changes, the whole tone.
    nearest = min(range(TRIES), key=lambda number: (distances[number], -number))
    chosen = next((number for number in range(TRIES) if distances[number] <= 1), nearest)
    return Colouring(known_range.nearest(embeddings[chosen]), tones[chosen])


def light_in_words(tone: Float[Tensor, "2 3"]) -> str:
    """How the light in a photo with this tone (gains > 0) differs from that in the training photos, as in "darker,
    bluer"; empty if hardly."""
    channels = tone.log().mean(dim=0)
    brightness = channels.mean()
    words = []
    if abs(brightness) > log(PLAIN):
        words.append("brighter" if brightness > 0 else "darker")
    if channels.max() - brightness > log(PLAIN):
        words.append(TINTS[int(channels.argmax())])
    return ", ".join(words)


def tone_layers(trained: TrainedRun) -> Float[Tensor, "2 bands 3"]:
    """What the place and the sky each contribute to the mean colour of each band
    of the training views, in the neutral look."""
    neutral = bake(trained, neutral_look(trained))
    alone = [
        toned(neutral, torch.tensor(gains)[:, None].expand(2, 3), trained.sky_count)
        for gains in ((1.0, 0.0), (0.0, 1.0))
    ]
    layers = []
    for photo in spread_over(trained.collection.split("train"), VIEWS):
        camera = trained.camera(photo)
        camera = camera.resized(-(-camera.width // SHRUNK), -(-camera.height // SHRUNK))
        pictures = [trained.rasterizer.render(part, camera).permute(2, 0, 1) for part in alone]
        layers.append(torch.stack([band_means(picture.clamp(0, 1)) for picture in pictures]))
    return torch.stack(layers).mean(dim=0)
