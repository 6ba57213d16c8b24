"""Common look of Matplotlib pictures: films and stills of a drive, drawings of the manual."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from filters.validation import FloatArray
from stereo_slam_env.report.charts.style import GRID, INK, MUTED

P = ParamSpec("P")

WIDTH_INCHES = 10.4
PNG_DPI = 160

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


def frame_track(ax: Axes, track: FloatArray, across: int, up: int) -> None:
    """Limits around the track, equal scales; x points down when z runs across (the view is from above)."""
    ax.set_aspect("equal", adjustable="box", anchor="NW")
    if len(track):
        margin = 0.06 * float(np.ptp(track[:, [across, up]], axis=0).max()) + 0.5
        low, high = track.min(axis=0) - margin, track.max(axis=0) + margin
        ax.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]))
    if across == 2:
        ax.invert_yaxis()


def save_png(figure: Figure, path: Path) -> None:
    """Write the figure on white."""
    with style_context():
        figure.savefig(path, format="png", dpi=PNG_DPI, facecolor="white", pil_kwargs={"compress_level": 1})
