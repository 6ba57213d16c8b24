"""From a Matplotlib figure to the same chart in Plotly: hover, zoom, series that can be switched off.

A figure is drawn once, with Matplotlib. What it shows is read off its artists here, so that none is described twice.

The label of an artist is the name of its series: it is what hovering says, and all artists of that name are switched
together. A detail may follow the name ("euclidean | predict"). A label with an underscore in front ("_euclidean")
belongs to the series but says nothing (bounds, single runs); an artist without a label is background. A unit in
brackets at the end of a label or title, "time (s)", is shown with the values.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator, NullLocator

from stereo_slam_env.report.charts.interactive_artists import SCALE, Units, hexadecimal, traces_of
from stereo_slam_env.report.charts.style import style_context

Spec = dict[str, Any]

_X_ANCHORS = {"left": "left", "center": "center", "right": "right"}
_Y_ANCHORS = {"top": "top", "center": "middle", "center_baseline": "middle", "bottom": "bottom", "baseline": "bottom"}
_UNIT = re.compile(r"\(([^\s()]{1,8})\)")


def plotly_figure(figure: Figure, *, drawn: bool = False) -> Spec:
    """Describe the figure as a Plotly chart.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Lines, markers, bands, bars, error bars, polygons and texts, on linear or logarithmic axes.
    drawn : bool
        Whether it has been drawn (saved) since it last changed; if not, it is, which takes as long as saving it.

    Returns
    -------
    dict
        `data` and `layout`, JSON-able, in the figure's own colours. `layout["meta"]` holds `series`, the name and
        colour of each, and `aspect`, width over height.

    Raises
    ------
    ValueError
        The figure holds what has no counterpart here (images, meshes, other projections or scales).
    """
    with style_context():
        if not drawn:
            figure.draw_without_rendering()  # settles positions, limits and ticks
        layout: Spec = {
            "margin": {"l": 0, "r": 0, "t": 0, "b": 0, "pad": 0, "autoexpand": False},
            "paper_bgcolor": "rgba(0,0,0,0)",
            "plot_bgcolor": "rgba(0,0,0,0)",
            "showlegend": False,
            "barmode": "overlay",
            "hovermode": "closest",
            "annotations": [_figure_text(text, figure) for text in figure.texts if text.get_text()],
        }
        data: list[Spec] = []
        colours: dict[str, str] = {}
        for number, ax in enumerate(figure.axes, start=1):
            suffix = "" if number == 1 else str(number)
            _check(ax)
            for trace in traces_of(ax, _units(ax)):
                data.append(trace | {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"})
                if "name" in trace and trace.get("hoverinfo") != "skip":
                    colours.setdefault(trace["name"], trace["meta"])
            layout |= _axes(ax, figure, suffix)
            layout["annotations"] += _titles(ax, suffix) + [_text(text, ax, suffix) for text in _visible_texts(ax)]
    for item in (*data, *layout["annotations"]):
        item.pop("meta", None)
        if item.get("name", "") not in colours:
            item.pop("name", None)
    series = [{"name": name, "colour": colour} for name, colour in colours.items()]
    layout["meta"] = {"series": series, "aspect": round(figure.get_figwidth() / figure.get_figheight(), 4)}
    return {"data": data, "layout": layout}


def _check(ax: Axes) -> None:
    if ax.name != "rectilinear":
        raise ValueError(f"figure must have rectilinear axes to be interactive, got {ax.name!r}")
    for axis in (ax.xaxis, ax.yaxis):
        if axis.get_scale() not in ("linear", "log"):
            raise ValueError(f"figure must have linear or log axes to be interactive, got {axis.get_scale()!r}")


def _units(ax: Axes) -> Units:
    x, y = _unit(ax.get_xlabel()), _unit(ax.get_ylabel()) or _unit(ax.get_title(loc="left"))
    named = [isinstance(axis.get_major_locator(), FixedLocator) for axis in (ax.xaxis, ax.yaxis)]
    return None if named[0] else x, None if named[1] else y


def _unit(label: str) -> str:
    found = _UNIT.search(label)
    return found[1] if found else ""


# ---- axes -----------------------------------------------------------------------------------------------------------


def _axes(ax: Axes, figure: Figure, suffix: str) -> Spec:
    box = ax.get_position()
    x = _axis(ax.xaxis, ax.get_xlim(), (box.x0, box.x1))
    y = _axis(ax.yaxis, ax.get_ylim(), (box.y0, box.y1))
    x["anchor"], y["anchor"] = f"y{suffix}", f"x{suffix}"
    if ax.get_aspect() == 1.0:
        y |= {"scaleanchor": f"x{suffix}", "constrain": "domain"}
        x["constrain"] = "domain"
    else:
        x |= _match(ax, figure, "x")
        y |= _match(ax, figure, "y")
    return {f"xaxis{suffix}": x, f"yaxis{suffix}": y}


def _match(ax: Axes, figure: Figure, which: str) -> Spec:
    """Zoom together with the first of the axes that share this one."""
    shared = ax.get_shared_x_axes() if which == "x" else ax.get_shared_y_axes()
    first = next(i for i, other in enumerate(figure.axes, start=1) if other is ax or shared.joined(ax, other))
    return {} if figure.axes[first - 1] is ax else {"matches": which if first == 1 else f"{which}{first}"}


def _axis(axis: Axis, limits: tuple[float, float], domain: tuple[float, float]) -> Spec:
    log = axis.get_scale() == "log"
    ends = np.log10(limits) if log else np.asarray(limits)
    tick = axis.get_tick_params(which="major")
    label = axis.label
    side = axis.get_label_position()
    spec: Spec = {
        "domain": [round(min(max(float(end), 0.0), 1.0), 5) for end in domain],
        "range": [float(f"{end:.6g}") for end in ends],
        "type": "log" if log else "linear",
        "side": side,
        "title": {"text": _markup(label.get_text()), "font": _font(label), "standoff": 6},
        "showgrid": bool(tick.get("gridOn", False)),
        "gridcolor": _grid_colour(axis),
        "gridwidth": 1,
        "zeroline": False,
        "showline": True,
        "linecolor": hexadecimal(axis.axes.spines[side].get_edgecolor()),
        "ticks": "",
        "showticklabels": bool(tick.get(f"label{side}", True)),
        "hoverformat": ".4~g",
        "visible": axis.axes.axison,
    }
    labels = axis.get_ticklabels()
    if labels:
        spec["tickfont"] = _font(labels[0])
    locator = axis.get_major_locator()
    if isinstance(locator, NullLocator):
        spec |= {"tickmode": "array", "tickvals": []}
    elif isinstance(locator, FixedLocator):
        places = [float(place) for place in locator()]
        texts = axis.get_major_formatter().format_ticks(places)
        colours = {label.get_text(): hexadecimal(label.get_color()) for label in labels}
        spec |= {"tickmode": "array", "tickvals": [float(f"{place:.6g}") for place in places]}
        spec["ticktext"] = [_coloured(text, colours.get(text)) for text in texts]
        spec["tickangle"] = -labels[0].get_rotation() if labels else 0
    elif log:
        decades = abs(float(ends[1] - ends[0]))
        # Plotly labels 1, 2, 5, 10 where there are at least 0.3 decades for each of so many ticks, else all digits.
        spec |= {"tickformat": "~g", "nticks": 5 if decades < 1 else int(np.clip(decades / 0.31, 3, 8))}
    else:
        spec["nticks"] = max(len(axis.get_majorticklocs()) + 1, 4)
    return spec


def _grid_colour(axis: Axis) -> str:
    lines = axis.get_gridlines()
    return hexadecimal(lines[0].get_color()) if lines else "#00000000"


# ---- texts ----------------------------------------------------------------------------------------------------------


def _titles(ax: Axes, suffix: str) -> list[Spec]:
    """Titles sit at the corners of the axes, whatever size these take on the screen."""
    found = []
    for text, place in ((ax._left_title, 0.0), (ax.title, 0.5), (ax._right_title, 1.0)):  # type: ignore[attr-defined]
        if text.get_text():
            anchors = {0.0: "left", 0.5: "center", 1.0: "right"}
            note = _annotation(text) | {"x": place, "y": 1.0, "xanchor": anchors[place], "yanchor": "bottom"}
            found.append(note | {"xref": f"x{suffix} domain", "yref": f"y{suffix} domain", "yshift": 5})
    return found


def _visible_texts(ax: Axes) -> list[Text]:
    return [text for text in ax.texts if text.get_text() and text.get_visible()]


def _text(text: Text, ax: Axes, suffix: str) -> Spec:
    note = _annotation(text) | {"name": text.get_text()}
    refs = {"xref": f"x{suffix}", "yref": f"y{suffix}"}
    coordinates = text.xycoords if isinstance(text, Annotation) else None
    if isinstance(text, Annotation) and coordinates in ("data", "axes fraction"):
        shift = [float(v) for v in text.xyann] if text.anncoords == "offset points" else [0.0, 0.0]
        (x, y), on_data = map(float, text.xy), coordinates == "data"
        if text.arrow_patch is not None:
            colour = hexadecimal(text.arrow_patch.get_edgecolor())
            note |= {"showarrow": True, "ax": SCALE * shift[0], "ay": -SCALE * shift[1], "arrowcolor": colour}
            note |= {"arrowhead": 2, "arrowsize": 0.8, "arrowwidth": 1}
        else:
            note |= {"xshift": round(SCALE * shift[0], 1), "yshift": round(SCALE * shift[1], 1)}
    else:
        on_data = text.get_transform() == ax.transData
        anchor = text.get_transform().transform(text.get_position())
        x, y = text.get_position() if on_data else ax.transAxes.inverted().transform(anchor)
    if on_data:
        x = np.log10(x) if ax.get_xscale() == "log" else x
        y = np.log10(y) if ax.get_yscale() == "log" else y
    else:
        refs = {name: f"{ref} domain" for name, ref in refs.items()}
    return note | refs | {"x": float(f"{x:.6g}"), "y": float(f"{y:.6g}")}


def _figure_text(text: Text, figure: Figure) -> Spec:
    x, y = figure.transFigure.inverted().transform(text.get_transform().transform(text.get_position()))
    return _annotation(text) | {"x": round(x, 4), "y": round(y, 4), "xref": "paper", "yref": "paper"}


def _annotation(text: Text) -> Spec:
    spec: Spec = {
        "text": _markup(text.get_text(), bold=text.get_fontweight() in ("bold", "semibold", 600, 700)),
        "font": _font(text),
        "showarrow": False,
        "xanchor": _X_ANCHORS[text.get_horizontalalignment()],
        "yanchor": _Y_ANCHORS[text.get_verticalalignment()],
        "align": text.get_horizontalalignment(),
        "borderpad": 0,
    }
    if text.get_rotation():
        spec["textangle"] = -text.get_rotation()
    return spec


def _font(text: Text) -> Mapping[str, Any]:
    return {"size": round(SCALE * float(text.get_fontsize()), 1), "color": to_hex(text.get_color())}


def _markup(text: str, bold: bool = False) -> str:
    """Plotly reads texts as a small HTML."""
    plain = escape(text, quote=False).replace("\n", "<br>")
    return f"<b>{plain}</b>" if bold and plain else plain


def _coloured(text: str, colour: str | None) -> str:
    return f'<span style="color:{colour}">{_markup(text)}</span>' if colour else _markup(text)
