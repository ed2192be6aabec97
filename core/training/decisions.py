"""What a scene needs, decided from its photos before anything is built: which parts, how many steps and Gaussians.

Where the figures are uncertain a part is kept: a part too many costs time, one too few costs the picture.
"""

from collections.abc import Sequence

import numpy as np

from core.automatic import budget
from core.config import Settings
from core.run.decision import Decision
from core.run.sized_photo import SizedPhoto
from core.training.evidence import FEWEST_CLOSEST, FEWEST_VIEWS, Evidence, gather_evidence
from core.words import counted

# 8-bit steps. Against no looks, the exposure mode (zero-shot, half protocol, held-out training photos) lost 1.9 dB at
# 3.6 (fountain) and 0.1 at 5.1 (calm plaza with gains of 4 %), and won 0.1 at 9.2 (gains of 9 %).
LEAST_COLOUR_SPREAD = 6.0
# 8-bit steps. At the error of in-the-wild runs (20 dB, 25 steps) as much unexplained costs less than 0.1 dB.
LEAST_SPREAD_BEYOND_EXPOSURE = 3.5
# Columns and corners make 0.5 to 1 % of calm photos (plaza) look so, crowds in the same light 3.7 %.
LEAST_STRANGE_SHARE = 0.015
# Photos. Masks learned from ten photos of plaza found hardly anyone (three times ten: IoU 0.04 to 0.13, 0.0 dB
# zero-shot, - 0.1 refined), those from eight of kermit, where nobody passes, hid the background and cost 0.9 and 0.5
# dB. Removing the Gaussians that masks from eight photos of Sacre-Coeur hide cost 0.1 and 0.4 dB, and took away trees
# that only one or two of them show (two seeds; all at `quick`). DensityControl removes none from fewer photos, either.
FEWEST_FOR_MASKS = 20
# Degree 1 against 0 on held-out training photos, dB: + 0.3 at 90 % (fountain), + 0.2 at 59 % (kermit), 0 at 33 % (calm
# plaza), 0 to + 0.4 at 21 % (Liberty), 0 to - 0.5 at 4 % (plaza).
LEAST_VIEW_DEPENDENCE = 0.1
TOO_FEW = "too few points are known to be shared by photos to tell"
FROM_EMPTY_SPACE = f"{TOO_FEW} what differs, and photos cut out of empty space are taken for renders in one light"
USUAL_DEGREE = 1  # where nothing can be said; higher degrees need more views of a point than SfM tracks have


def decide(
    settings: Settings, points: np.ndarray, photos: Sequence[SizedPhoto]
) -> tuple[Settings, tuple[Decision, ...]]:
    """Settings in which nothing is left to be decided, and the decisions taken; none where all was given.

    points: SfM points (P, 3), scene frame. photos: the training photos, decoded at training size.
    """
    empty = settings.transparent_is_empty or any(sized.empty is not None for sized in photos)
    pixels = sum(sized.camera.width * sized.camera.height for sized in photos)
    settings = settings.decided(
        **budget(len(photos), pixels), sky="none" if empty else "dome", transparency="empty" if empty else "unseen"
    )
    asked = [name for name in JUDGES if name in settings.undecided]
    if not asked:
        return settings, ()
    evidence = gather_evidence(points, photos)
    taken = {name: judge(evidence) for name, judge in JUDGES.items()}
    if empty:
        # Renders of one thing in one light: there, looks and masks that are kept unjudged cost 1.8 dB (biker, 200 px,
        # 600 steps).
        unjudged = [name for name in ("appearance", "transients") if taken[name].figure is None]
        taken |= {name: Decision(name, "off", None, FROM_EMPTY_SPACE) for name in unjudged}
    decided = settings.decided(**{name: decision.value for name, decision in taken.items()})
    return decided, tuple(taken[name] for name in asked)


def judge_appearance(evidence: Evidence) -> Decision:
    """off, exposure or full."""
    spread, left = evidence.colour_spread, evidence.spread_beyond_exposure
    if spread is None or left is None:
        why = f"{TOO_FEW} whether their light differs; `--appearance off` leaves looks out"
        return Decision("appearance", "full", None, why)
    differ = f"a point's colour differs by {spread:.1f} of 255 between photos"
    if spread < LEAST_COLOUR_SPREAD:
        return Decision("appearance", "off", spread, f"{differ}, less than {LEAST_COLOUR_SPREAD:g}")
    rest = f"{differ}; a gain and offset per photo leave {left:.1f}"
    if left < LEAST_SPREAD_BEYOND_EXPOSURE:
        return Decision("appearance", "exposure", left, f"{rest}, less than {LEAST_SPREAD_BEYOND_EXPOSURE:g}")
    return Decision("appearance", "full", left, rest)


def judge_transients(evidence: Evidence) -> Decision:
    """off or on."""
    if evidence.strange_share is None:
        too_few_places = f"fewer than {FEWEST_CLOSEST} places are shown by photos from nearby, too few to tell"
        why = f"{TOO_FEW if evidence.colour_spread is None else too_few_places} whether there are passers-by"
        if evidence.photos < FEWEST_FOR_MASKS:
            few = f"{counted(evidence.photos, 'photo')} hardly teach what these look like"
            return Decision("transients", "off", None, f"{why}, and {few}; `--transients on` makes masks")
        return Decision("transients", "on", None, f"{why}; `--transients off` leaves masks out")
    share = f"{evidence.strange_share:.1%} of the places look unlike what photos from nearby show there"
    if evidence.strange_share < LEAST_STRANGE_SHARE:
        return Decision("transients", "off", evidence.strange_share, f"{share}, less than {LEAST_STRANGE_SHARE:.1%}")
    return Decision("transients", "on", evidence.strange_share, share)


def judge_sh_degree(evidence: Evidence) -> Decision:
    """0 or 1."""
    if evidence.view_dependence is None:
        why = (
            f"too few points are seen by {FEWEST_VIEWS} photos to tell whether colours depend on the viewing direction"
        )
        return Decision("sh_degree", USUAL_DEGREE, None, why)
    share = f"the viewing direction explains {evidence.view_dependence:.0%} of what colours differ by within a look"
    if evidence.view_dependence < LEAST_VIEW_DEPENDENCE:
        return Decision("sh_degree", 0, evidence.view_dependence, f"{share}, less than {LEAST_VIEW_DEPENDENCE:.0%}")
    return Decision("sh_degree", 1, evidence.view_dependence, share)


JUDGES = {"appearance": judge_appearance, "transients": judge_transients, "sh_degree": judge_sh_degree}
