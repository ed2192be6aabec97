"""Every schedule of a run, as functions of its progress in [0, 1]."""

from core.config import Settings

MEAN_RATE_DECAY = 0.01
NETWORK_RATE_DECAY = 0.1
CONTRIBUTION_FRACTIONS = (1 / 8, 5 / 8)  # of the steps after growth
COARSEST = 4  # coarse-to-fine starts at a quarter of the size
STEP_TIMES = (1 / 3, 1 / 2)  # of a step at a quarter and at half of the size; medians of runs of plaza, Liberty and Sacré-Cœur


def decayed(rate: float, progress: float, final_share: float) -> float:
    """Exponential decay from `rate` to `final_share * rate`, as 3DGS does for centres."""
    return rate * final_share**progress


def shrink_factor(settings: Settings, progress: float) -> int:
    """By how much photos are shrunk now: 4, then 2, then 1 for the rest of the run."""
    if progress >= settings.coarse_until:
        return 1
    return COARSEST if progress < settings.coarse_until / 2 else COARSEST // 2


def time_through(settings: Settings, step: int) -> float:
    """The share of a run's time, in [0, 1], that has passed after `step` steps: early ones, on shrunk photos, take less."""
    coarse = settings.coarse_until

    def time(progress: float) -> float:
        coarsest = min(progress, coarse / 2)
        coarser = min(progress, coarse) - coarsest
        return STEP_TIMES[0] * coarsest + STEP_TIMES[1] * coarser + (progress - coarsest - coarser)

    return time(step / settings.steps) / time(1.0)


def densification_steps(settings: Settings) -> list[int]:
    """The steps after which Gaussians are pruned and grown, ascending and distinct."""
    first, last = settings.densify_from * settings.steps, settings.densify_until * settings.steps
    rounds = settings.densify_rounds
    return sorted({max(1, round(first + (last - first) * i / max(rounds - 1, 1))) for i in range(rounds)})


def contribution_steps(settings: Settings) -> set[int]:
    """The steps after which Gaussians that no photo needs are removed: when growth has ended, and once more when settled."""
    if not settings.prune_contribution:
        return set()
    grown = settings.densify_until
    return {max(1, round(settings.steps * (grown + (1 - grown) * fraction))) for fraction in CONTRIBUTION_FRACTIONS}


def evenly(count: int, steps: int) -> set[int]:
    """`count` steps spread evenly over the run, the last one included."""
    return {max(1, round(steps * (i + 1) / count)) for i in range(count)}
