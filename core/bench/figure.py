"""A work-precision figure as data: what was measured, in which panels it is drawn,
and which choices are not beaten by any other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.errors import BadInput


@dataclass(frozen=True)
class Spread:
    """The median of repeated measurements and their quartiles; all three are equal for what does not vary."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float]) -> "Spread":
        """Of one or more measurements."""
        low, median, high = np.quantile(np.asarray(values, dtype=np.float64), (0.25, 0.5, 0.75)).tolist()
        return Spread(median, low, high)

    @staticmethod
    def exactly(value: float) -> "Spread":
        """Of something that is counted or computed, not timed."""
        return Spread(float(value), float(value), float(value))

    def scaled(self, factor: float) -> "Spread":
        """In another unit."""
        return Spread(self.median * factor, self.low * factor, self.high * factor)

    def words(self) -> str:
        """Three digits, with the quartiles where they differ: `1.23 (1.20 to 1.31)`."""
        if self.low == self.high:
            return number(self.median)
        return f"{number(self.median)} ({number(self.low)} to {number(self.high)})"


def number(value: float) -> str:
    """A figure for people: three digits, more only for large whole numbers."""
    return f"{value:.0f}" if abs(value) >= 999.5 else f"{value:.3g}"


@dataclass(frozen=True)
class Quantity:
    """A column. name: a word for files. label: with its unit, for people.
    scale: "linear", "log" or "steps" (0, then doubling).

    limit: a value and its name, drawn as a line, or None. floor: on a logarithmic axis, what lies below is drawn there.
    """

    name: str
    label: str
    scale: str = "linear"
    more_is_better: bool = False
    limit: tuple[float, str] | None = None
    floor: float = 0.0


@dataclass(frozen=True)
class Point:
    """One choice and what it costs and gives. curve: the line it belongs to. label: the choice itself.

    values: by name of quantity; a quantity that was not measured here is absent. is_default: what wegs does unless told
    otherwise.
    """

    curve: str
    label: str
    values: dict[str, Spread]
    is_default: bool = False


@dataclass(frozen=True)
class Panel:
    """A picture of quantity `y` (error or quality) over quantity `x` (work: less is better).

    labelled: whether choices are written beside their points; needless where the axis tells them.
    """

    x: str
    y: str
    labelled: bool = True


@dataclass(frozen=True)
class Figure:
    """Points and the panels they are drawn in. name: of its files. made_on: machine, threads, versions, seed.

    notes: a line each for what a reader has to know. Raises BadInput where nothing was measured.
    """

    name: str
    title: str
    quantities: tuple[Quantity, ...]
    panels: tuple[Panel, ...]
    points: tuple[Point, ...]
    made_on: dict[str, str]
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        if not self.points:
            raise BadInput(f"There is nothing to draw in the figure `{self.name}`.", "Measure another run.")

    def quantity(self, name: str) -> Quantity:
        """The column called `name`."""
        return next(quantity for quantity in self.quantities if quantity.name == name)

    def curves(self) -> dict[str, list[Point]]:
        """The points of each curve, in the order of measurement."""
        found: dict[str, list[Point]] = {}
        for point in self.points:
            found.setdefault(point.curve, []).append(point)
        return found

    def shown(self, panel: Panel) -> list[Point]:
        """The points that have both quantities of the panel."""
        return [point for point in self.points if panel.x in point.values and panel.y in point.values]

    def beaten_by(self, point: Point, panel: Panel) -> list[Point]:
        """The points that are no worse in either quantity of the panel and better in one, by their medians."""
        work, gain = self._rank(point, panel)
        found = []
        for other in self.shown(panel):
            other_work, other_gain = self._rank(other, panel)
            if other_work <= work and other_gain >= gain and (other_work, other_gain) != (work, gain):
                found.append(other)
        return found

    def front(self, panel: Panel) -> list[Point]:
        """The Pareto front: the points that no other beats, by ascending work."""
        front = [point for point in self.shown(panel) if not self.beaten_by(point, panel)]
        return sorted(front, key=lambda point: self._rank(point, panel))

    def _rank(self, point: Point, panel: Panel) -> tuple[float, float]:
        """Work, and gain: the other quantity, negated where less of it is better."""
        gain = point.values[panel.y].median
        return point.values[panel.x].median, gain if self.quantity(panel.y).more_is_better else -gain

    def verdicts(self) -> list[str]:
        """A line for each panel on where the defaults lie; none if no point is a default."""
        lines = []
        for panel in self.panels:
            defaults = [point for point in self.shown(panel) if point.is_default]
            if not defaults:
                continue
            over = f"{self.quantity(panel.y).label} over {self.quantity(panel.x).label}"
            # One choice may stand on several curves, such as of several runs: it is as good as the best of these.
            better = min((self.beaten_by(point, panel) for point in defaults), key=len)
            name = f"{defaults[0].curve}: {defaults[0].label}" if len(defaults) == 1 else "the default"
            if not better:
                lines.append(f"{over}: {name} is on the front.")
            else:
                nearest = max(better, key=lambda point: self._rank(point, panel)[0])
                lines.append(f"{over}: {name} is beaten by {len(better)}, such as {nearest.curve}: {nearest.label}.")
        return lines
