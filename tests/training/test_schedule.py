"""Schedules are fractions of a run, however many steps it has."""

import numpy as np
import pytest

from core.training import schedule
from tests.small import whole_settings


def test_schedules_are_fractions_of_the_steps():
    short = whole_settings(steps=100)
    for rounds, shares in ((3, (0.1, 0.4, 0.7)), (1, (0.1,)), (0, ())):
        growth = {"densify_from": 0.1, "densify_until": 0.7, "densify_rounds": rounds}
        for steps in (10, 100_000):
            expected = [round(share * steps) for share in shares]
            assert schedule.densification_steps(whole_settings(steps=steps, **growth)) == expected
    assert [
        schedule.shrink_factor(short, progress) for progress in (0.0, short.coarse_until / 2, short.coarse_until)
    ] == [4, 2, 1]
    assert schedule.evenly(4, 100) == {25, 50, 75, 100}
    assert schedule.contribution_steps(whole_settings(steps=101)) == {66, 86} and schedule.settled_step(short) == 85
    assert [schedule.begun(short, short.mask_apply + later)[-1] for later in (-0.01, 0.0)] == [False, True]
    through = [schedule.time_through(short, step) for step in range(101)]
    times = np.diff(through)
    assert (through[0], through[-1]) == (0.0, pytest.approx(1.0))
    assert times[5] / times[50] == pytest.approx(0.45) and times[15] / times[50] == pytest.approx(0.6)
    late = whole_settings(steps=100, densify_until=0.9)
    assert min(schedule.contribution_steps(late)) > schedule.densification_steps(late)[-1]


def test_nothing_grows_after_the_last_step():
    to_the_end = whole_settings(steps=100, densify_from=0.5, densify_until=1.0, densify_rounds=3)
    assert schedule.densification_steps(to_the_end) == [50, 75]
    assert schedule.densification_steps(to_the_end.changed(steps=1)) == []


def test_what_no_photo_needs_is_removed_twice_during_a_long_growth():
    growth = {"densify_from": 0.2, "densify_until": 0.6}
    long = whole_settings(steps=6000, densify_rounds=8, **growth)
    rounds, after = schedule.densification_steps(long), {3900, 5100}
    assert schedule.contribution_steps(long) == {rounds[4], rounds[6], *after} and len(rounds) == 8
    one = whole_settings(steps=6000, densify_rounds=1, **growth)
    assert schedule.contribution_steps(one) == schedule.contribution_steps(one.changed(densify_rounds=0)) == after
    short = long.changed(steps=5998)
    assert len(schedule.contribution_steps(short)) == 2
    assert schedule.contribution_steps(long.changed(prune_contribution=0.0)) == set()
