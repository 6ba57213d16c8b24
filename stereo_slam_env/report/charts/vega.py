"""Layers of a Vega-Lite specification: common look, encodings, rows of data and words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from stereo_slam_env.report.charts.style import GRID, MUTED

Spec: TypeAlias = dict[str, Any]

THEME: Spec = {
    "aria": False,  # the page says what a chart shows
    "background": None,
    "font": "Arial, Helvetica, 'Liberation Sans', sans-serif",
    "padding": 3,
    "view": {"stroke": None},
    "axis": {
        "domainColor": GRID,
        "gridColor": GRID,
        "labelColor": MUTED,
        "labelFlush": False,
        "labelFontSize": 11.5,
        "tickColor": GRID,
        "tickSize": 4,
        "titleColor": MUTED,
        "titleFontSize": 12,
        "titleFontWeight": "normal",
        "titlePadding": 7,
    },
}
"""Look of every chart."""
COLOURED: Spec = {
    "color": {"field": "colour", "type": "nominal", "scale": None, "legend": None},
    "opacity": {"field": "opacity", "type": "quantitative", "scale": None, "legend": None},
}
UPRIGHT: Spec = {"size": 12.0, "angle": 0.0, "baseline": "middle"}
ID: Spec = {"field": "id", "type": "ordinal"}
AS_GIVEN: Spec = {"value": None}
"""Order in which a line joins its points; Vega-Lite would sort them by x, and a path may turn back."""
SAID: Spec = {"field": "said", "type": "nominal", "title": " "}


def drawn(rows: Sequence[Spec], mark: Spec, encoding: Spec, where: str = "") -> Spec:
    """One layer of a view: rows, of which lists are points, a mark, and where what goes."""
    lists = [name for name, value in rows[0].items() if isinstance(value, list)]
    transform: list[Spec] = [{"filter": "indexof(hidden, datum.key) < 0" + (f" && {where}" if where else "")}]
    if lists:
        transform.append({"flatten": lists})
    return {"data": {"values": list(rows)}, "transform": transform, "mark": mark, "encoding": encoding}


def written(texts: Sequence[Spec]) -> list[Spec]:
    """One layer for each way of writing."""
    ways: dict[tuple[str, bool, str], list[Spec]] = {}
    for text in texts:
        ways.setdefault((text["align"], text["bold"], text["baseline"]), []).append(text)
    layers = []
    for (align, bold, baseline), rows in ways.items():
        weight = "bold" if bold else "normal"
        mark = {"type": "text", "clip": False, "align": align, "baseline": baseline, "fontWeight": weight}
        places = {name: {"field": name, "type": "quantitative", "scale": None, "axis": None} for name in ("x", "y")}
        styles = {
            name: {"field": name, "type": "quantitative", "scale": None, "legend": None} for name in ("size", "angle")
        }
        words = {"text": {"field": "text", "type": "nominal"}, "color": COLOURED["color"]}
        layers.append(drawn(rows, mark, places | styles | words))
    return layers


def with_shared_data(view: Spec, data: Spec) -> Spec:
    """The view with names in the place of its data, which goes to `data`, each set of it once."""
    layers = []
    for layer in view["layer"]:
        rows = layer["data"]["values"]
        name = next((known for known, found in data.items() if found == rows), f"rows_{len(data)}")
        data[name] = rows
        layers.append(layer | {"data": {"name": name}})
    return view | {"layer": layers}
