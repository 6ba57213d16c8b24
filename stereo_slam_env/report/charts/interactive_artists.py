"""The artists of Matplotlib axes as Plotly traces, in drawing order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Transform

from filters.validation import FloatArray
from stereo_slam_env.report.charts.style import WIDTH_INCHES

Trace = dict[str, Any]

PAGE_PIXELS = 1080
"""Width of a figure of `WIDTH_INCHES` in the page."""
SCALE = PAGE_PIXELS / (72 * WIDTH_INCHES)
"""Pixels of the page in a point of the figure."""
Units = tuple[str | None, str | None]
"""Of x and y: "" where there is none, None where the axis has names instead of values."""

DETAIL = " | "
"""Between the name of a series and what one of its artists adds to it."""

MAX_MARKERS = 3000
"""A browser draws no more in comfort; clouds are thinned evenly."""

_DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
_STEPS = {"steps-post": "hv", "steps": "vh", "steps-pre": "vh", "steps-mid": "hvh"}
_SYMBOLS = {
    "o": "circle", ".": "circle", "s": "square", "D": "diamond", "d": "diamond", "^": "triangle-up",
    "v": "triangle-down", "<": "triangle-left", ">": "triangle-right", "x": "x-thin", "+": "cross-thin",
    "*": "star", "|": "line-ns", "_": "line-ew",
}  # fmt: skip


def traces_of(ax: Axes, units: Units) -> list[Trace]:
    """Describe everything that is drawn in the axes.

    Parameters
    ----------
    ax : Axes
        After a draw, so that limits and colours are settled.
    units : pair
        Of x and y.

    Returns
    -------
    list of dict
        Traces without their axes. `meta` holds the colour of the series, as a key shows it.

    Raises
    ------
    ValueError
        An image or a mesh: they have no counterpart here.
    """
    if ax.images:
        raise ValueError("figure must not hold images to be interactive")
    drawn: list[tuple[float, Iterable[Trace]]] = []
    inside: set[Artist] = set()
    for container in ax.containers:
        label = str(container.get_label())
        if isinstance(container, BarContainer):
            inside |= set(container.patches)
            drawn.append(
                (container.patches[0].get_zorder() if container.patches else 0, _bars(container, label, units))
            )
        if isinstance(container, ErrorbarContainer):
            line, caps, spans = container.lines
            inside |= {*caps, *spans, *([line] if line is not None else [])}
            first = line if line is not None else spans[0]
            drawn.append((first.get_zorder(), _error_bars(container, ax, label, units)))
    for artist in (*ax.lines, *ax.collections, *ax.patches):
        if artist not in inside and artist.get_visible():
            drawn.append((artist.get_zorder(), _traces(artist, ax, units)))
    return [trace for _, traces in sorted(drawn, key=lambda pair: pair[0]) for trace in traces]


def hexadecimal(colour: Any, alpha: float | None = None) -> str:
    """Colour as #rrggbb, or #rrggbbaa where it is not opaque."""
    rgba = to_rgba(colour, alpha)
    return to_hex(rgba, keep_alpha=rgba[3] < 1)


def _traces(artist: Artist, ax: Axes, units: Units) -> Iterator[Trace]:
    if isinstance(artist, Line2D):
        yield _line(artist, ax, units)
    elif isinstance(artist, LineCollection):
        yield from _segments(artist, ax, units)
    elif isinstance(artist, PathCollection):
        yield from _markers(artist, ax, units)
    elif isinstance(artist, (PolyCollection, ContourSet)):
        yield from _areas(artist, ax, units)
    elif isinstance(artist, Patch):
        yield from _patch(artist, ax, units)
    else:
        raise ValueError(f"figure must not hold a {type(artist).__name__} to be interactive")


def _common(label: str, colour: str, units: Units) -> Trace:
    """What hovering says, and which series the trace belongs to (see `interactive`)."""
    silent = not label or label.startswith("_")
    name, *detail = label.removeprefix("_").split(DETAIL)
    trace: Trace = {"name": name, "meta": colour[:7]} if name else {"meta": colour[:7]}
    if silent:
        return trace | {"hoverinfo": "skip"}
    said = [_value(axis, unit) for axis, unit in zip("yx", units[::-1], strict=True) if unit is not None]
    return trace | {"hovertemplate": f"{'<br>at '.join(said)}<extra>{escape(', '.join([name, *detail]))}</extra>"}


def _value(variable: str, unit: str | None) -> str:
    return f"%{{{variable}:.4~g}}" + (f" {escape(unit)}" if unit else "")


def _line(line: Line2D, ax: Axes, units: Units) -> Trace:
    xy = _in_data(np.ma.filled(np.ma.asarray(line.get_xydata(), dtype=np.float64), np.nan), line.get_transform(), ax)
    colour = hexadecimal(line.get_color(), line.get_alpha())
    with_line, symbol = line.get_linestyle() not in ("None", " ", ""), _SYMBOLS.get(str(line.get_marker()))
    xy = _thinned(xy, ax) if with_line else _every(xy, MAX_MARKERS)
    mode = "+".join(part for part, on in (("lines", with_line), ("markers", symbol is not None)) if on) or "none"
    trace = _scatter(xy, mode, _common(str(line.get_label()), colour, units))
    if with_line:
        dash = _DASHES.get(str(line.get_linestyle()), "dash")
        trace["line"] = {"color": colour, "width": round(SCALE * line.get_linewidth(), 2), "dash": dash}
        if line.get_drawstyle() in _STEPS:
            trace["line"]["shape"] = _STEPS[line.get_drawstyle()]
    if symbol is not None:
        trace["marker"] = _marker(symbol, line.get_markersize(), line.get_markerfacecolor(), line.get_alpha())
        edge = hexadecimal(line.get_markeredgecolor(), line.get_alpha())
        trace["marker"]["line"] = {"color": edge, "width": SCALE if "thin" in symbol or "line" in symbol else 0}
        if str(line.get_markerfacecolor()) == "none":
            trace["marker"] |= {"symbol": f"{symbol}-open", "color": edge}
    return trace


def _marker(symbol: str, points: float, colour: Any, alpha: float | None) -> Trace:
    size = round(SCALE * points * (0.5 if symbol == "." else 1.0), 2)
    return {"symbol": symbol, "size": size, "color": hexadecimal(colour, alpha), "opacity": 1}


def _segments(lines: LineCollection, ax: Axes, units: Units) -> Iterator[Trace]:
    gap = np.full((1, 2), np.nan)
    pieces = [np.vstack([_in_data(np.asarray(s), lines.get_transform(), ax), gap]) for s in lines.get_segments()]
    if pieces:
        colour = hexadecimal(lines.get_color()[0])
        trace = _scatter(np.vstack(pieces), "lines", _common(str(lines.get_label()), colour, units))
        yield trace | {"line": {"color": colour, "width": round(SCALE * _first(lines.get_linewidth()), 2)}}


def _markers(cloud: PathCollection, ax: Axes, units: Units) -> Iterator[Trace]:
    xy = _in_data(
        np.ma.filled(np.ma.asarray(cloud.get_offsets(), np.float64), np.nan), cloud.get_offset_transform(), ax
    )
    if not len(xy):
        return
    step = -(-len(xy) // MAX_MARKERS)
    faces, edges = cloud.get_facecolor(), cloud.get_edgecolor()
    hollow = not len(faces)
    colours = [hexadecimal(colour) for colour in (edges if hollow else faces)]
    sizes = SCALE * np.sqrt(cloud.get_sizes())
    marker = {
        "symbol": "circle-open" if hollow else "circle",
        "color": colours[::step] if len(colours) == len(xy) > 1 else colours[0],
        "size": np.round(sizes[::step], 2).tolist() if len(sizes) == len(xy) > 1 else round(float(sizes[0]), 2),
        "opacity": 1,
        "line": {"width": round(SCALE * _first(cloud.get_linewidth()), 2) if hollow else 0},
    }
    trace = _scatter(xy[::step], "markers", _common(str(cloud.get_label()), colours[0], units))
    yield trace | {"marker": marker}


def _areas(areas: Collection, ax: Axes, units: Units) -> Iterator[Trace]:
    faces, edges, widths = areas.get_facecolor(), areas.get_edgecolor(), np.atleast_1d(areas.get_linewidth())
    for i, path in enumerate(areas.get_paths()):
        face = faces[i % len(faces)] if len(faces) else "none"
        edge = edges[i % len(edges)] if len(edges) else "none"
        width = widths[i % len(widths)] if len(widths) else 0.0
        if trace := _polygon(path, areas.get_transform(), ax, face, edge, width, str(areas.get_label()), units):
            yield trace


def _patch(patch: Patch, ax: Axes, units: Units) -> Iterator[Trace]:
    face = patch.get_facecolor() if patch.get_fill() else "none"
    transform, width, label = patch.get_transform(), patch.get_linewidth(), str(patch.get_label())
    if trace := _polygon(patch.get_path(), transform, ax, face, patch.get_edgecolor(), width, label, units):
        yield trace


def _polygon(
    path: Path, transform: Transform, ax: Axes, face: Any, edge: Any, width: float, label: str, units: Units
) -> Trace | None:
    gap = np.full((1, 2), np.nan)
    pieces = [np.vstack([outline, gap]) for outline in _outlines(path, transform, ax)]
    if not pieces:
        return None
    outlined = width > 0 and to_rgba(edge)[3] > 0
    filled = to_rgba(face)[3] > 0
    colour = hexadecimal(edge if outlined else face)
    # Hovering over an area has no value to tell: the line of the same series has.
    common = _common(label if label.startswith("_") else f"_{label}", colour, units)
    trace = _scatter(np.vstack(pieces), "lines" if outlined else "none", common)
    if filled:
        trace |= {"fill": "toself", "fillcolor": hexadecimal(face)}
    return trace | {"line": {"color": colour, "width": round(SCALE * width, 2)}} if outlined else trace


def _bars(bars: BarContainer, label: str, units: Units) -> Iterator[Trace]:
    if not bars.patches:
        return
    boxes = np.array([(p.get_x(), p.get_y(), p.get_width(), p.get_height()) for p in bars.patches])
    colours = [hexadecimal(p.get_facecolor()) for p in bars.patches]
    trace = _common(label, colours[0], units) | {"type": "bar", "marker": {"color": colours, "line": {"width": 0}}}
    lying = bars.orientation == "horizontal"
    along, across = (0, 1) if lying else (1, 0)
    value, place = ("x", "y") if lying else ("y", "x")
    if "hovertemplate" in trace:
        trace["hovertemplate"] = f"{_value(value, units[along])}<extra>{escape(label.replace(DETAIL, ', '))}</extra>"
    yield trace | {
        "orientation": "h" if lying else "v",
        place: _numbers(boxes[:, across] + 0.5 * boxes[:, 2 + across]),
        "width": _numbers(boxes[:, 2 + across]),
        "base": _numbers(boxes[:, along]),
        value: _numbers(boxes[:, 2 + along]),
    }


def _error_bars(bars: ErrorbarContainer, ax: Axes, label: str, units: Units) -> Iterator[Trace]:
    line, _, spans = bars.lines
    if line is None:
        for span in spans:
            yield from _segments(span, ax, units)
        return
    trace = _line(line, ax, units)
    trace = {name: value for name, value in trace.items() if name not in ("name", "hoverinfo", "hovertemplate")}
    colour = hexadecimal(line.get_color(), line.get_alpha())
    trace |= _common(label, colour, units)
    xy = np.asarray(line.get_xydata(), dtype=np.float64)
    axes = [name for name, present in (("x", bars.has_xerr), ("y", bars.has_yerr)) if present]
    for name, span in zip(axes, spans, strict=True):
        column = "xy".index(name)
        # A bar with an end that is not known has no segment.
        segments = [np.asarray(segment, dtype=np.float64).reshape(-1, 2) for segment in span.get_segments()]
        ends = np.array([s[:, column] if len(s) == 2 else (np.nan, np.nan) for s in segments]).reshape(-1, 2)
        if len(ends) != len(xy):
            yield from _segments(span, ax, units)
            continue
        trace[f"error_{name}"] = {
            "type": "data",
            "symmetric": False,
            "array": _numbers(ends.max(axis=1) - xy[:, column]),
            "arrayminus": _numbers(xy[:, column] - ends.min(axis=1)),
            "color": hexadecimal(span.get_color()[0]),
            "thickness": round(SCALE * _first(span.get_linewidth()), 2),
            "width": 0,
        }
        if "hovertemplate" in trace:
            trace["customdata"] = [_numbers(pair) for pair in np.sort(ends, axis=1)]
            interval = "%{customdata[0]:.4~g} to %{customdata[1]:.4~g}"
            said = f"{_value(name, units[column])}<br>{interval}"
            trace["hovertemplate"] = f"{said}<extra>{escape(label.replace(DETAIL, ', '))}</extra>"
    yield trace


# ---- numbers --------------------------------------------------------------------------------------------------------


def _scatter(xy: FloatArray, mode: str, common: Trace) -> Trace:
    return {"type": "scatter", "mode": mode, "x": _numbers(xy[:, 0]), "y": _numbers(xy[:, 1])} | common


def _numbers(values: Iterable[float]) -> list[float | None]:
    """Five significant digits; a gap where a value is not finite."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def _first(values: float | Sequence[float]) -> float:
    return float(np.atleast_1d(values)[0])


def _in_data(xy: FloatArray, transform: Transform, ax: Axes) -> FloatArray:
    """Points drawn by another transform (`axhline`, `axvspan`) in the coordinates of the axes."""
    if transform == ax.transData or not len(xy):
        return xy
    return np.asarray((transform - ax.transData).transform(xy), dtype=np.float64)


def _pixels(ax: Axes) -> int:
    figure = ax.get_figure(root=True)
    assert figure is not None
    return max(int(ax.get_position().width * figure.get_figwidth() * 72 * SCALE), 100)


def _every(xy: FloatArray, most: int) -> FloatArray:
    return xy[:: max(-(-len(xy) // most), 1)]


def _thinned(xy: FloatArray, ax: Axes) -> FloatArray:
    """At most some two points a pixel: of each stretch the lowest and the highest, so that no peak is lost."""
    pixels = _pixels(ax)
    if len(xy) <= 2 * pixels:
        return xy
    stretches = np.array_split(np.arange(len(xy)), pixels)
    keep = {0, len(xy) - 1}
    for stretch in stretches:
        y = xy[stretch, 1]
        gaps = ~np.isfinite(y)
        if gaps.any():
            keep.add(int(stretch[np.argmax(gaps)]))
        if not gaps.all():
            keep |= {int(stretch[np.nanargmin(y)]), int(stretch[np.nanargmax(y)])}
    return xy[sorted(keep)]


def _outlines(path: Path, transform: Transform, ax: Axes) -> list[FloatArray]:
    """Polygons of a path in data coordinates, without points that the screen would not show."""
    back = ax.transData.inverted()
    outlines = []
    for polygon in transform.transform_path(path).to_polygons(closed_only=False):
        vertices = np.asarray(polygon, np.float64)
        shown = Path(vertices).cleaned(simplify=len(vertices) >= 128)
        codes = np.asarray(shown.codes)
        points = np.asarray(shown.vertices, np.float64)[(codes == Path.MOVETO) | (codes == Path.LINETO)]
        outlines.append(np.asarray(back.transform(points), np.float64))
    return outlines
