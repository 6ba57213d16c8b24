"""How every figure looks: colours that mean one thing everywhere, quiet axes, labels on the lines.

Figures are drawn in the light colours below; `figures` swaps them for CSS variables when a figure goes into a
page, so that one drawing serves light and dark.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from scipy.optimize import isotonic_regression

from filters.validation import FloatArray

P = ParamSpec("P")

INK = "#1b1f24"
"""Text and ground truth."""
MUTED = "#6a717a"
"""Axis labels, raw measurements."""
GRID = "#e4e7eb"
"""Grid and axis lines."""
BAND = "#dde3ea"
"""Expected range (chi-square bands)."""

# Okabe and Ito's colour-blind-safe set, darkened where a thin line on white needs it.
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#a3458f", "#a67c00", "#4597c9", "#7a5c48", "#5b6bb5")
_RESERVED = {"inverse-depth": 0, "dual-bearing": 1, "euclidean": 2}

WIDTH_INCHES = 10.4

_RC: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": GRID,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": MUTED,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.formatter.useoffset": False,
    "figure.facecolor": "none",
    "font.size": 8.5,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "path.simplify_threshold": 0.3,
    "svg.fonttype": "none",
    "svg.hashsalt": "stereo-slam",
    "text.color": INK,
    "text.parse_math": False,  # names may hold any characters, "$" too
    "xtick.color": GRID,
    "xtick.labelcolor": MUTED,
    "xtick.labelsize": 8,
    "ytick.color": GRID,
    "ytick.labelcolor": MUTED,
    "ytick.labelsize": 8,
}


def styled(plot: Callable[P, Figure]) -> Callable[P, Figure]:
    """Run a plot function under the common style, leaving the caller's matplotlib settings alone."""

    @functools.wraps(plot)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(_RC):
            return plot(*args, **kwargs)

    return wrapper


def style_context() -> Any:
    """Return the settings a styled figure must also be saved under (fonts and ids are decided on saving)."""
    return mpl.rc_context(_RC)


def filter_colours(names: Iterable[str]) -> dict[str, str]:
    """Give each filter one colour, whatever the order of `names`; the standard three keep theirs, unless not there."""
    distinct = sorted(set(names))
    free = [i for i in range(len(PALETTE)) if i not in _RESERVED.values()]
    free += [slot for name, slot in _RESERVED.items() if name not in distinct]  # last, so that few change nothing
    others = [name for name in distinct if name not in _RESERVED]
    slots = _RESERVED | {name: free[i % len(free)] for i, name in enumerate(others)}
    return {name: PALETTE[slots[name]] for name in distinct}


def nested_widths(count: int) -> list[float]:
    """Line widths from broad to fine: of curves on top of each other, each one still shows."""
    return [1.0 + 1.6 * (count - 1 - i) for i in range(count)] if count > 1 else [1.3]


class Limit(NamedTuple):
    """Where an axis ends, and which filters go beyond it (with how far)."""

    upper: float
    beyond: dict[str, float]


def shared_limit(peaks: Mapping[str, float], spread: float = 10.0) -> Limit:
    """Find the end of an axis so that one diverged filter does not flatten the others.

    Parameters
    ----------
    peaks : mapping of str to float
        Largest value of each filter; entries that are not finite or not positive are left out.
    spread : float
        Filters whose peak is more than this many times the smallest peak go beyond the axis.

    Returns
    -------
    Limit
        Upper end, and the filters that are cut off.
    """
    known = {name: peak for name, peak in peaks.items() if np.isfinite(peak) and peak > 0}
    if not known:
        return Limit(1.0, {})
    allowed = spread * min(known.values())
    upper = max(peak for peak in known.values() if peak <= allowed)
    return Limit(upper, {name: peak for name, peak in known.items() if peak > allowed})


def note_beyond(ax: Axes, limit: Limit, colours: Mapping[str, str], unit: str = "") -> None:
    """Say above the axes which filters leave them, and how far they go."""
    if not limit.beyond:
        return
    far = ", ".join(f"{name} to {short_number(peak)}{unit}" for name, peak in limit.beyond.items())
    colour = colours[next(iter(limit.beyond))] if len(limit.beyond) == 1 else MUTED
    ax.set_title(f"↑ {far}", loc="right", color=colour, fontweight="normal", fontsize=8.5)


def short_number(value: float) -> str:
    """Write a number with two digits that count: 0.083, 27, 150,000, 1.4e+09."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:,.0f}" if 100 <= abs(rounded) < 1e7 else f"{rounded:g}"


def plain_log_axis(ax: Axes, axis: str = "y") -> None:
    """Write 0.1, 0.2, 0.5, 1 on a log axis instead of powers of ten."""
    scaled = ax.yaxis if axis == "y" else ax.xaxis
    low, high = ax.get_ylim() if axis == "y" else ax.get_xlim()
    if high < 4 * low:
        scaled.set_major_locator(MaxNLocator(5))
    else:
        scaled.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 500 * low else (1.0,)))
    scaled.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    scaled.set_minor_locator(NullLocator())


class EndLabel(NamedTuple):
    """A name to write at the right end of a line, at height `y` (data units)."""

    text: str
    y: float
    colour: str


def label_ends(ax: Axes, labels: Sequence[EndLabel], gap_points: float = 11.5) -> None:
    """Write the labels in the right margin, moved apart where lines end close together.

    Call it after the limits of the axes are final.
    """
    inside = sorted((label for label in labels if np.isfinite(label.y)), key=lambda label: label.y)
    if not inside:
        return
    to_axes = ax.transData + ax.transAxes.inverted()
    x_end = ax.get_xlim()[1]
    wanted = np.clip([to_axes.transform((x_end, label.y))[1] for label in inside], 0.0, 1.0)
    places = _spread(wanted, gap_points / _height_points(ax))
    for label, place in zip(inside, places, strict=True):
        _write_in_margin(ax, label.text, place, label.colour)


def colour_key(ax: Axes, colours: Mapping[str, str], gap_points: float = 12.5) -> None:
    """Write the names one below the other in the right margin, for lines that lie on top of each other."""
    for row, (name, colour) in enumerate(colours.items()):
        _write_in_margin(ax, name, 1 - (row + 0.5) * gap_points / _height_points(ax), colour)


def name_rows(
    ax: Axes, names: Sequence[str], colours: Mapping[str, str], notes: Mapping[str, str] | None = None
) -> None:
    """Write the names of filters at y = 0, 1, ..., each in its colour, with a note behind it if there is one."""
    texts = [f"{name} {notes[name]}" if notes and name in notes else name for name in names]
    ax.set_yticks(range(len(names)), texts)
    for tick, name in zip(ax.get_yticklabels(), names, strict=True):
        tick.set_color(colours[name])
    ax.grid(visible=False, axis="y")


def _height_points(ax: Axes) -> float:
    figure = ax.get_figure(root=True)
    assert figure is not None
    return float(ax.get_position().height * figure.get_figheight() * 72)


def _write_in_margin(ax: Axes, text: str, place: float, colour: str) -> None:
    ax.annotate(
        text,
        (1, place),
        (6, 0),
        xycoords="axes fraction",
        textcoords="offset points",
        color=colour,
        va="center",
        annotation_clip=False,
    )


def _spread(wanted: FloatArray, gap: float) -> FloatArray:
    """Return places at least `gap` apart in the ascending order of `wanted`, nearest in least squares."""
    if len(wanted) < 2:
        return wanted
    offsets = gap * np.arange(len(wanted))
    # With places = offsets + t, "at least gap apart" reads "t does not decrease".
    places: FloatArray = np.asarray(isotonic_regression(wanted - offsets).x, dtype=np.float64) + offsets
    return places
