"""The plan of the collection: which photo is taken from where, in which light, with whom in it."""

from dataclasses import dataclass, replace

import numpy as np

from samples.plaza_maker.cameras import View, draw_view, look_at
from samples.plaza_maker.church import church
from samples.plaza_maker.crowd import SHRINK, populate
from samples.plaza_maker.looks import KINDS, WEATHER_EXPOSURE, Look, draw_look
from samples.plaza_maker.rays import Group, World, cast
from samples.plaza_maker.square import static_groups

SEED = 20
COUNTS = {"noon": 9, "morning": 7, "afternoon": 9, "cloudy": 9, "overcast": 7, "sunset": 7, "dusk": 6, "night": 6}
WIDEST = 100.0  # degrees to either side of the front


@dataclass(frozen=True)
class Shot:
    """A photo to be taken. name: the file's stem. share: of the picture that passers-by should cover."""

    name: str
    view: View
    look: Look
    share: float
    seed: int

    def passers_by(self) -> tuple[Group, ...]:
        """The passers-by in this photo; the same at every call."""
        return populate(np.random.default_rng(self.seed), World(static_groups()), self.view, self.share)


def _worth_taking(view: View, of_church: int, ground: int) -> bool:
    """Whether the church fills enough of the view and nothing stands in front of the lens.

    The solids numbered below of_church are the church's, those from there to `ground` stand about the square.
    """
    small = view.shrunk(SHRINK)
    hits = cast(World(static_groups()), small.centre.astype(np.float32), small.rays())
    landmark = (hits.number >= 0) & (hits.number < of_church)
    blocking = (hits.number >= of_church) & (hits.number < ground) & (hits.distance < 10)
    if landmark.mean() < 0.25 or blocking.mean() > 0.07:
        return False
    return np.quantile(hits.distance, 0.005) > 1.0 and np.quantile(hits.distance[landmark], 0.05) > 8.0


def _test_names(shots: list[Shot]) -> set[str]:
    """One photo of each kind of light: the one with the nearest neighbours, well inside the range of views."""
    centres = np.array([shot.view.centre for shot in shots])
    forward = np.array([shot.view.world_to_camera[2] for shot in shots])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) + 25 * (1 - forward @ forward.T)
    nearness = np.sort(apart, axis=1)[:, 1:5].mean(axis=1)
    unfit = (
        np.array([shot.view.focal_px > 400 or shot.share == 0 or shot.view.dip < np.radians(4) for shot in shots]) * 100
    )
    return {
        min((near, shot.name) for near, shot in zip(nearness + unfit, shots) if shot.look.kind == kind)[1]
        for kind in KINDS
    }


def plan(times: int = 1) -> tuple[list[Shot], set[str]]:
    """All shots of the collection by ascending name, and the names of the test photos.
    times: how often there are COUNTS of each light."""
    rng = np.random.default_rng(SEED)
    # Of all that stays, the church comes first and the ground last.
    of_church, ground = len(World(tuple(church())).solids), len(World(static_groups()).solids) - 1
    kinds = [kind for kind, count in COUNTS.items() for _ in range(times * count)]
    count = len(kinds)
    azimuths = (np.arange(count) + 0.5) / count * 2 - 1
    azimuths = np.sign(azimuths) * np.abs(azimuths) ** 1.25 * WIDEST  # denser in front, as tourists are
    shots = []
    for number, (kind, azimuth) in enumerate(zip(rng.permutation(kinds), rng.permutation(azimuths)), start=1):
        view = draw_view(rng, azimuth)
        looks_up = rng.random() < 0.12  # a few show roofs and sky only
        while not (_worth_taking(view, of_church, ground) and (looks_up or view.dip > np.radians(4))):
            view = draw_view(rng, azimuth)
        share = 0.0 if rng.random() < 0.05 else float(rng.uniform(0.08, 0.24))
        shots.append(Shot(f"{number:04d}", view, draw_look(str(kind), rng), share, int(rng.integers(1 << 30))))
    return shots, _test_names(shots)


def styles() -> list[Shot]:
    """Photos from outside the collection, whose light its scene is to take on."""
    dusk = draw_look("dusk", np.random.default_rng(21), clouds=0.45)
    noon = draw_look("noon", np.random.default_rng(35), clouds=0.3)
    return [
        Shot("dusk", look_at((-0.5, -31.0, 2.2), (1.0, 4, 9.8), 265, 320, 240, 0.6), dusk, 0.10, 5),
        Shot("noon", look_at((12.0, -30.0, 2.4), (1.5, 4, 9.4), 270, 320, 240, -0.8), noon, 0.10, 6),
    ]


VARIANTS = {
    "calm": "one light, one exposure, nobody about",
    "exposure": "one light, an exposure and white balance for each photo, nobody about",
    "crowd": "one light, one exposure, the crowds of the collection",
}


def variant(shots: list[Shot], name: str) -> list[Shot]:
    """The same views with less in them, so that a part of the method is not needed. name: a key of VARIANTS."""
    same = replace(
        draw_look("afternoon", np.random.default_rng(SEED + 2), clouds=0.2),
        exposure=1.0,
        balance=(1.0, 1.0, 1.0),
        gamma=1.0,
        contrast=0.2,
        saturation=1.0,
        lift=0.0,
        vignette=0.0,
        grain=0.8,
    )
    made = []
    for shot in shots:
        look = same
        if name == "exposure":
            look = replace(
                same, exposure=shot.look.exposure / WEATHER_EXPOSURE[shot.look.kind], balance=shot.look.balance
            )
        made.append(replace(shot, look=look, share=shot.share if name == "crowd" else 0.0))
    return made
