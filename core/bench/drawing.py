"""A figure as a picture: a panel for each pair of quantities, the Pareto front, the defaults, the machine.

matplotlib is imported when something is drawn: it takes half a second to load.
"""

import io
import logging
import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from core.bench.figure import Figure, Panel, Point, Quantity, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.typing import RcKeyType

DPI = 130
PANEL_INCHES = 5.4, 4.2
MARGIN_INCHES = 1.0  # for title and footer
LEGEND_INCHES = 2.2  # where no cell is free for it
# Where a label may stand beside its point: the shift in pt, and the alignment.
BESIDE = (
    ((8, 5), "left"),
    ((8, -11), "left"),
    ((-8, 5), "right"),
    ((-8, -11), "right"),
    ((0, 9), "center"),
    ((0, -16), "center"),
)
MARKER_PX = 4  # from the middle of a point to where a label may begin
NARROW = 4.0  # the end of a logarithmic scale over its start, below which 1, 2 and 5 name hardly anything
# Paul Tol's `bright` and `muted` qualitative colours (personal.sron.nl/~pault): told apart by colour-blind readers too.
COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#882255", "#44aa99", "#999933", "#332288")
MARKERS = "osD^vPX<>h"
INK, FAINT, FRONT = "#222222", "#8a8a8a", "#e9a13b"
STYLE: "dict[RcKeyType, Any]" = {
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 9,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ebebeb",
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
}


def draw_png(figure: Figure) -> bytes:
    """The picture as the bytes of a PNG file."""
    # It warns of a home that cannot be written in, and does without.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    count = len(figure.panels)
    columns = min(count, 2)
    rows = math.ceil(count / columns)
    is_full = count == rows * columns
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box, which says it as well.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        width, height = PANEL_INCHES[0] * columns, PANEL_INCHES[1] * rows + MARGIN_INCHES
        canvas = Canvas(figsize=(width + LEGEND_INCHES if is_full else width, height), dpi=DPI, layout="constrained")
        agg = FigureCanvasAgg(canvas)  # its own, so that no window system is asked for
        canvas.suptitle(figure.title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK, parse_math=False)
        axes = canvas.subplots(rows, columns, squeeze=False).flatten()
        for axis, panel in zip(axes, figure.panels, strict=False):
            _draw_panel(axis, figure, panel)
        curves = axes[0].get_legend_handles_labels()
        if is_full:
            legend = canvas.legend(*curves, loc="outside right upper")
        else:
            axes[-1].axis("off")
            legend = axes[-1].legend(*curves, loc="upper left", fontsize=10, labelspacing=0.8)
        for text in legend.get_texts():  # a run may be called $_$
            text.set_parse_math(False)
        facts = "   ".join(f"{name} {value}" for name, value in figure.made_on.items())
        canvas.supxlabel("\n".join([*figure.notes, facts]), x=0.01, ha="left", fontsize=7.5, color=FAINT)
        agg.draw()  # places the axes: only then it is known which labels would overlap
        for axis, panel in zip(axes, figure.panels, strict=False):
            if panel.labelled:
                _label_points(axis, figure, panel)
        png = io.BytesIO()
        canvas.savefig(png, format="png", facecolor="white")
    return png.getvalue()


def _draw_panel(axis: "Axes", figure: Figure, panel: Panel) -> None:
    x, y = figure.quantity(panel.x), figure.quantity(panel.y)
    shown = figure.shown(panel)
    floor = _floor(y, shown)

    def places(points: list[Point]) -> tuple[list[float], list[float]]:
        return [_place(point, x) for point in points], [_place(point, y, floor) for point in points]

    for row, (curve, points) in enumerate(figure.curves().items()):
        points = [point for point in points if point in shown]
        colour, marker = COLOURS[row % len(COLOURS)], MARKERS[row % len(MARKERS)]
        axis.errorbar(
            *places(points), xerr=_bars(points, x), yerr=_bars(points, y),
            label=f" {curve}" if curve.startswith("_") else curve,  # matplotlib hides those that begin so
            color=colour, marker=marker, ms=5, lw=1.2, elinewidth=0.9, capsize=1.5, alpha=0.9, zorder=3,
        )  # fmt: skip
    if front := figure.front(panel):
        axis.step(*places(front), where="post", color=FRONT, lw=5, alpha=0.35, zorder=1, label="Pareto front")
        axis.plot(*places(front), "o", ms=11, mfc="none", mec=FRONT, mew=1.6, zorder=4)
    if defaults := [point for point in shown if point.is_default]:
        axis.plot(
            *places(defaults), "*", ms=15, mfc="white", mec=INK, mew=1.3, ls="none", zorder=5, label="as it comes"
        )
    _scale(axis, "x", x)
    _scale(axis, "y", y)
    if y.limit is not None:
        axis.axhline(y.limit[0], color=FAINT, lw=1, ls=(0, (4, 3)), zorder=2)
        end = axis.get_yaxis_transform()
        axis.text(0.995, y.limit[0], y.limit[1], transform=end, ha="right", va="bottom", fontsize=7.5, color=FAINT)
    if math.isfinite(floor):
        axis.axhline(floor, color=FAINT, lw=0.6, ls=":", zorder=2)
        words = f"{number(floor)} or less"
        axis.text(0.005, floor, words, transform=axis.get_yaxis_transform(), fontsize=7.5, color=FAINT, va="bottom")
    better = "up" if y.more_is_better else "down"
    axis.set_title(f"{y.label} over {x.label}", loc="left", fontsize=10, color=INK)
    axis.set_xlabel(x.label + "  (better: left)")
    axis.set_ylabel(y.label + f"  (better: {better})")
    axis.margins(0.12 if panel.labelled else 0.08, 0.08)


def _floor(quantity: Quantity, points: list[Point]) -> float:
    """Where a logarithmic axis shows values that are too small for it, such as 0; -inf if there are none."""
    values = [point.values[quantity.name].median for point in points]
    above = [value for value in values if value > quantity.floor]
    if quantity.scale != "log" or len(above) == len(values):
        return -math.inf
    return quantity.floor or (min(above) / 10 if above else -math.inf)


def _place(point: Point, quantity: Quantity, floor: float = -math.inf) -> float:
    return max(point.values[quantity.name].median, floor)


def _bars(points: list[Point], quantity: Quantity) -> list[list[float]]:
    """How far the quartiles lie below and above the medians."""
    spreads = [point.values[quantity.name] for point in points]
    return [[s.median - s.low for s in spreads], [s.high - s.median for s in spreads]]


def _scale(axis: "Axes", which: str, quantity: Quantity) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    if quantity.scale == "linear":
        return
    if quantity.scale == "steps":
        getattr(axis, f"set_{which}scale")("symlog", base=2, linthresh=1)
        getattr(axis, f"{which}axis").set_major_formatter(FuncFormatter(lambda value, _: number(value)))
        return
    getattr(axis, f"set_{which}scale")("log")
    low, high = getattr(axis, f"get_{which}lim")()
    ticks = getattr(axis, f"{which}axis")
    if math.log10(high / low) < 2.5:  # few whole powers of ten: name the numbers between them as well
        ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high / low > NARROW else MaxNLocator(4))
        ticks.set_major_formatter(FuncFormatter(lambda value, _: number(value)))
        ticks.set_minor_formatter(NullFormatter())


def _label_points(axis: "Axes", figure: Figure, panel: Panel) -> None:
    """Write labels beside the defaults, the front, the ends of curves and then all other points,
    where there is room and no other point is nearer."""
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    x, y = figure.quantity(panel.x), figure.quantity(panel.y)
    shown = figure.shown(panel)
    floor = _floor(y, shown)
    first = [point for point in shown if point.is_default]
    ends = [end for points in figure.curves().values() for end in (points[0], points[-1]) if end in shown]
    middles = [axis.transData.transform((_place(point, x), _place(point, y, floor))) for point in shown]
    taken = [Bbox.from_extents(*(middle - MARKER_PX), *(middle + MARKER_PX)) for middle in middles]
    taken += [text.get_window_extent() for text in axis.texts]
    written: set[tuple[float, float]] = set()
    frame = axis.get_window_extent()
    for point in [*first, *figure.front(panel), *ends, *shown]:
        at = _place(point, x), _place(point, y, floor)
        if at in written:
            continue
        for shift, align in BESIDE:
            halo = withStroke(linewidth=2.5, foreground="white")
            label = axis.annotate(
                point.label,
                at,
                shift,
                textcoords="offset points",
                ha=align,
                zorder=6,
                fontsize=7.5,
                color=INK,
                path_effects=[halo],
            )
            box = label.get_window_extent()
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 + 20 and frame.y0 <= box.y0 and box.y1 <= frame.y1
            centre = (box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2
            nearest = min(middles, key=lambda middle: math.dist(middle, centre))
            is_its_own = np.array_equal(nearest, axis.transData.transform(at))
            if inside and is_its_own and not any(box.overlaps(other) for other in taken):
                taken.append(box)
                written.add(at)
                break
            label.remove()
