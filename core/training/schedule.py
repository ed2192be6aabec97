"""Every schedule of a run, as functions of its progress in [0, 1]."""

from core.config import Settings

MEAN_RATE_DECAY = 0.01
NETWORK_RATE_DECAY = 0.1
CONTRIBUTION_FRACTIONS = (1 / 8, 5 / 8)  # of the steps after growth
LONG_GROWTH = 2400  # steps: in a quarter of them, Gaussians become what they are judged by
SHRINK_FACTORS = (4, 2, 1)  # of photos, coarse to fine
STEP_TIMES = (0.45, 0.6, 1.0)  # of a step on them, in full steps; medians of runs of plaza, Liberty and Sacré-Cœur


def decayed(rate: float, progress: float, final_share: float) -> float:
    """Exponential decay from `rate` to `final_share * rate`, as 3DGS does for centres."""
    return rate * final_share**progress


def shrink_factor(settings: Settings, progress: float) -> int:
    """The factor by which photos are shrunk at this progress."""
    return next(
        (factor for factor, end in zip(SHRINK_FACTORS, _phase_ends(settings)) if progress < end), SHRINK_FACTORS[-1]
    )


def time_through(settings: Settings, step: int) -> float:
    """The share of a run's time, in [0, 1], that has passed after `step` steps:
    early steps, on shrunk photos, are faster."""

    def time(progress: float) -> float:
        reached = [min(progress, end) for end in _phase_ends(settings)]
        return sum(each * (end - start) for each, start, end in zip(STEP_TIMES, (0.0, *reached), reached))

    return time(step / settings.steps) / time(1.0)


def _phase_ends(settings: Settings) -> tuple[float, float, float]:
    """The progress at which each of SHRINK_FACTORS gives way to the next."""
    return settings.coarse_until / 2, settings.coarse_until, 1.0


def begun(settings: Settings, progress: float) -> tuple[bool, ...]:
    """Which of the parts that start in the course of a run have started:
    geometry, latents, learning masks, applying masks."""
    return tuple(
        progress >= start
        for start in (settings.geometry_from, settings.latents_from, settings.mask_start, settings.mask_apply)
    )


def densification_steps(settings: Settings) -> list[int]:
    """The steps after which Gaussians are pruned and grown, ascending and distinct;
    never the last step, after which nothing that grew could learn."""
    first, last = settings.densify_from * settings.steps, settings.densify_until * settings.steps
    rounds = settings.densify_rounds
    steps = {max(1, round(first + (last - first) * i / max(rounds - 1, 1))) for i in range(rounds)}
    return sorted(steps - {settings.steps})


def contribution_steps(settings: Settings) -> set[int]:
    """The steps after which Gaussians that no photo needs are removed:
    midway through a long growth and at three quarters of it, soon after it, and once more when they have settled."""
    if not settings.prune_contribution:
        return set()
    rounds, during = densification_steps(settings), set()
    if rounds and rounds[-1] - rounds[0] >= LONG_GROWTH:
        during = {rounds[len(rounds) * quarter // 4] for quarter in (2, 3)}
    return during | {_after_growth(settings, fraction) for fraction in CONTRIBUTION_FRACTIONS}


def settled_step(settings: Settings) -> int:
    """The step after which veils and passers-by are removed:
    Gaussians have settled, and enough steps are left to close the gaps."""
    return _after_growth(settings, CONTRIBUTION_FRACTIONS[-1])


def _after_growth(settings: Settings, fraction: float) -> int:
    grown = settings.densify_until
    return max(1, round(settings.steps * (grown + (1 - grown) * fraction)))


def evenly(count: int, steps: int) -> set[int]:
    """`count` steps spread evenly over the run, the last one included."""
    return {max(1, round(steps * (i + 1) / count)) for i in range(count)}
