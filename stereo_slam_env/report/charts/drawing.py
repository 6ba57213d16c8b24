"""Building blocks of charts: panels with two axes, what is drawn on them, and how a chart is saved.

A plot function makes panels, draws on them and puts them into one chart with `figure`. A chart is a Vega-Lite
specification, which the page draws with Vega and `vl_convert` draws into files, without a browser. Everything that is
drawn belongs to a series (its key), which the page can switch off, or to none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import vl_convert
from numpy.typing import ArrayLike

from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.files.folders import write_atomically, write_text
from stereo_slam_env.report.charts.axes import (
    AS_GIVEN,
    COLOURED,
    ID,
    INK,
    MUTED,
    PAPER,
    SAID,
    THEME,
    UPRIGHT,
    Axis,
    Limit,
    Spec,
    dash_of,
    drawn,
    shape_of,
    shared_limit,
    short,
    spread_out,
    with_shared_data,
    written,
)
from stereo_slam_env.report.charts.series import last_known, peak, thinned

_Kind = TypeVar("_Kind")
PNG_SCALE = 1.6
ROW = 30.0
"""Height of a row that belongs to one filter, px."""
POINTS_A_PIXEL = 0.45
"""Longer curves are thinned, with their peaks kept; those in the background twice as much."""
DASHED = (5.0, 4.0)


@dataclass(frozen=True, eq=False)
class Curve:
    """Points of one series, to be drawn as a line, as dots, as a band or with intervals."""

    key: str
    """Series that it belongs to and is switched off with; "" for background."""
    x: ArrayLike
    """(K,): NaN is a gap."""
    y: ArrayLike
    """(K,): NaN is a gap."""
    colour: str
    """One of `axes`."""
    low: ArrayLike | None = None
    """(K,): lower ends of a band or of an interval."""
    high: ArrayLike | None = None
    """(K,): upper ends of a band or of an interval."""
    width: float = 1.6
    """Width of the line, px."""
    opacity: float = 1.0
    """Opacity of the line, 0 to 1."""
    said: str | None = ""
    """What hovering says besides the values, instead of the key; None says nothing at all."""


@dataclass(frozen=True)
class BoxMark:
    """A filled rectangle between (x0, y0) and (x1, y1), in the units of the axes."""

    x0: float
    x1: float
    y0: float
    y1: float
    colour: str
    key: str = ""
    opacity: float = 1.0
    said: str | None = None


@dataclass
class Panel:
    """One pair of axes, and the layers drawn on it, from the lowest to the highest."""

    x: Axis
    """Axis to the right."""
    y: Axis
    """Axis upwards."""
    width: float
    """Width of the field between the axes, px."""
    height: float
    """Height of that field, px."""
    title: str = ""
    """Above it, with the unit of `y` where that has no title of its own."""
    title_colour: str = INK
    """Colour of the title."""
    zoom: bool = True
    """Whether dragging and Ctrl + wheel move and zoom it in the page."""
    _layers: list[Spec] = field(default_factory=list)
    _texts: list[Spec] = field(default_factory=list)

    def lines(self, curves: Iterable[Curve], dash: Sequence[float] = ()) -> None:
        """Draw each curve as a line, dashed as its colour is unless `dash` is given."""
        for dashes, group in _by(curves, lambda curve: tuple(dash) or dash_of(curve.colour)):
            self._lines(group, dashes)

    def _lines(self, curves: Sequence[Curve], dash: Sequence[float]) -> None:
        rows = [self._row(number, curve, self._kept(curve)) for number, curve in enumerate(curves)]
        mark = {
            "type": "line",
            "strokeDash": list(dash),
            "strokeCap": "butt" if dash else "round",
            "strokeJoin": "round",
        }
        width = {"field": "width", "type": "quantitative", "scale": None, "legend": None}
        self._layer(rows, mark, **COLOURED, strokeWidth=width, detail=ID, order=AS_GIVEN)
        if any(row["said"] is not None for row in rows):
            # Points that cannot be seen say the values; `live` is set where there is a pointer.
            point = {"type": "point", "opacity": 0, "size": 110}
            self._layer(rows, point, where="live && datum.said != null", tooltip=self._tooltip())

    def dots(self, curves: Iterable[Curve], size: float = 30.0, *, hollow: bool = False) -> None:
        """Draw a dot, an area of `size` px², at each point."""
        for shape, group in _by(curves, lambda curve: shape_of(curve.colour)):
            rows = [self._row(number, curve, _known(curve)) for number, curve in enumerate(group)]
            mark = {"type": "point", "shape": shape, "size": size, "filled": not hollow}
            mark |= {"strokeWidth": 2.0} | ({"fill": PAPER} if hollow else {})
            self._layer(rows, mark, **COLOURED, tooltip=self._tooltip())

    def intervals(self, curves: Iterable[Curve], *, across: bool = False) -> None:
        """Draw a stroke from `low` to `high` of each point: upright, or `across` (then they are values of x)."""
        rows = [self._row(number, curve, _known(curve), "low", "high") for number, curve in enumerate(curves)]
        fields = {"x": "low", "x2": "high"} if across else {"y": "low", "y2": "high"}
        self._layer(rows, {"type": "rule", "strokeWidth": 1.8}, fields, **COLOURED)

    def bands(self, curves: Iterable[Curve]) -> None:
        """Fill between `low` and `high` of each curve."""
        rows = [self._row(number, curve, self._kept(curve), "low", "high") for number, curve in enumerate(curves)]
        self._layer(rows, {"type": "area"}, {"y": "low", "y2": "high"}, **COLOURED, detail=ID)

    def outlines(self, curves: Iterable[Curve]) -> None:
        """Fill what each curve goes round; a path that crosses itself is filled on both sides."""
        rows = [self._row(number, curve, _known(curve)) for number, curve in enumerate(curves)]
        order = {"field": "at", "type": "quantitative"}
        rows = [row | {"at": [*range(len(row["x"]))]} for row in rows]
        fill = {"fill": COLOURED["color"], "fillOpacity": COLOURED["opacity"]}
        self._layer(rows, {"type": "line", "strokeWidth": 0}, **fill, order=order, detail=ID)

    def boxes(self, boxes: Iterable[BoxMark]) -> None:
        """Fill rectangles."""
        ends = ("x0", "x1", "y0", "y1")
        rows = [
            {"key": b.key, "said": b.said, "colour": b.colour, "opacity": b.opacity}
            | {end: short(getattr(b, end)) for end in ends}
            for b in boxes
        ]
        tooltip: Spec = {"tooltip": [SAID]} if any(row["said"] for row in rows) else {}
        self._layer(rows, {"type": "rect"}, {"x": "x0", "x2": "x1", "y": "y0", "y2": "y1"}, **COLOURED, **tooltip)

    def rule(
        self,
        *,
        x: float | None = None,
        y: float | None = None,
        colour: str = MUTED,
        width: float = 0.9,
        dash: Sequence[float] = (),
        opacity: float = 1.0,
    ) -> None:
        """Draw a straight line through the whole panel at a value of x or of y."""
        at = (x, x, self.y.low, self.y.high) if y is None else (self.x.low, self.x.high, y, y)
        ends = Curve("", at[:2], at[2:], colour, width=width, opacity=opacity, said=None)  # type: ignore[arg-type]
        self.lines([ends], dash)

    def text(
        self, text: str, x: float, y: float, colour: str = MUTED, *, key: str = "", align: str = "left", **more: Any
    ) -> None:
        """Write at (x, y), px from the upper left corner of the panel; `bold`, `size` and `angle` as wanted."""
        place = {"text": text, "x": short(x), "y": short(y), "colour": colour, "key": key, "align": align}
        self._texts.append(place | {"bold": False} | UPRIGHT | more)

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Position of a point of the data, px from the upper left corner."""
        return self.x.share(x) * self.width, (1.0 - self.y.share(y)) * self.height

    def note(self, text: str, colour: str = MUTED) -> None:
        """Write above the right end."""
        if text:
            self.text(text, self.width, -11, colour, align="right")

    def note_beyond(self, limit: Limit, colours: Mapping[str, str], unit: str = "") -> None:
        """Say above the right end which filters leave the panel, and how far they go."""
        self.note(limit.note(unit), limit.note_colour(colours))

    def end_labels(self, labels: Iterable[tuple[str, float, str]], gap: float = 14.5) -> None:
        """Write (name, value of y, colour) in the right margin, moved apart where lines end close together."""
        known = [(self.y.share(value), name, colour) for name, value, colour in labels if np.isfinite(value)]
        inside = sorted(known)
        places = spread_out([float(np.clip(share, 0.0, 1.0)) for share, *_ in inside], gap / self.height)
        for place, (_, name, colour) in zip(places, inside, strict=True):
            self.text(name, self.width + 7, (1.0 - place) * self.height, colour, key=name)

    def name_ends(self, curves: Iterable[Curve], limit: Limit | None = None) -> None:
        """Write the name of each curve that stays within the limit at its last value."""
        beyond = () if limit is None else limit.beyond
        self.end_labels((c.key, last_known(c.y), c.colour) for c in curves if c.key not in beyond)

    def colour_key(self, colours: Mapping[str, str], gap: float = 16.0) -> None:
        """Write the names one below the other in the right margin, for lines that lie on top of each other."""
        for row, (name, colour) in enumerate(colours.items()):
            self.text(name, self.width + 7, (row + 0.5) * gap, colour, key=name)

    def row_names(
        self, names: Sequence[str], colours: Mapping[str, str], notes: Mapping[str, str] | None = None
    ) -> None:
        """Write names at y = 0, 1, ... in the left margin, each in its colour, perhaps with a note behind it."""
        for row, name in enumerate(names):
            text = f"{name} {notes[name]}" if notes and name in notes else name
            self.text(text, -9, self.place(self.x.low, row)[1], colours.get(name, INK), align="right", key=name)

    def column_names(self, places: Sequence[float], names: Sequence[str], *, tilted: bool = False) -> None:
        """Write names below the panel, where x has no numbers."""
        style: Spec = {"align": "right", "angle": -30.0} if tilted else {"align": "center"}
        for place, name in zip(places, names, strict=True):
            self.text(name, self.place(place, self.y.low)[0] + 6 * tilted, self.height + 13, **style)

    def layered(self, number: int) -> Spec:
        """The panel as a view of Vega-Lite; `number` tells it from the other ones of its chart."""
        style = {"x": 0, "y": -11, "align": "left", "bold": True, "key": ""} | UPRIGHT
        title = {"text": self.title, "colour": self.title_colour, **style}
        texts = [*self._texts, title] if self.title else self._texts
        layers = self._layers or [self._drawn([{"x": None, "y": None}], {"type": "point", "opacity": 0})]
        if self.zoom:
            # Ctrl, or two fingers: the wheel alone goes on scrolling the page.
            select = {"type": "interval", "zoom": "wheel![event.ctrlKey]"}
            zoom = {"params": [{"name": f"zoom_{number}", "select": select, "bind": "scales"}]}
            layers = [layers[0] | zoom, *layers[1:]]
        return {"width": round(self.width), "height": round(self.height), "layer": [*layers, *written(texts)]}

    def _layer(self, rows: Sequence[Spec], mark: Spec, fields: Mapping[str, str] | None = None, **more: Any) -> None:
        if rows:
            self._layers.append(self._drawn(rows, mark, fields, **more))

    def _drawn(
        self,
        rows: Sequence[Spec],
        mark: Spec,
        fields: Mapping[str, str] | None = None,
        *,
        where: str = "",
        **encoding: Any,
    ) -> Spec:
        """Points that are drawn of the rows, whose lists are the points of a curve."""
        at = {"x": "x", "y": "y"} | dict(fields or {})
        sides: Spec = {
            "x": self.x.channel(at["x"], max(2, round(self.width / 75))),
            "y": self.y.channel(at["y"], max(2, round(self.height / 38))),
        } | {end: {"field": at[end]} for end in ("x2", "y2") if end in at}
        return drawn(rows, {**mark, "clip": True}, {**sides, **encoding}, where)

    def _row(self, number: int, curve: Curve, kept: IntArray, *ends: str) -> Spec:
        label = None if curve.said is None else curve.said or curve.key
        head = {"id": number, "key": curve.key, "said": label, "colour": curve.colour}
        values = {name: _numbers(self.y.within(getattr(curve, name)), kept) for name in ("y", *ends)}
        return head | {"width": curve.width, "opacity": curve.opacity, "x": _numbers(curve.x, kept)} | values

    def _kept(self, curve: Curve) -> IntArray:
        most = max(60, round(POINTS_A_PIXEL * self.width / (1 if curve.said is not None else 2)))
        return thinned(curve.y if curve.high is None else curve.high, most)

    def _tooltip(self) -> list[Spec]:
        values = {"x": self.x.title or "at"}
        if self.y.ticks != ():
            values["y"] = self.y.title or self.title
        number = {"type": "quantitative", "format": ".4~g"}
        return [SAID, *({"field": name, "title": title, **number} for name, title in values.items())]


@dataclass(frozen=True)
class Chart:
    """A drawing that can be used: a Vega-Lite specification, which notebooks show, and files."""

    spec: Spec
    """Specification for Vega-Lite, with its data."""

    @property
    def series(self) -> list[dict[str, str]]:
        """Name and colour of what can be switched off."""
        legend: list[dict[str, str]] = self.spec.get("usermeta", {}).get("series", [])
        return legend

    def svg(self) -> str:
        """Draw it as an SVG document, with its texts as text, on no background."""
        svg = vl_convert.vegalite_to_svg(self.spec)
        # Vega goes on counting from drawing to drawing: numbered anew, the same chart is the same text.
        clips = {name: f"clip{i}" for i, name in enumerate(dict.fromkeys(re.findall(r' id="(clip\d+)"', svg)))}
        return re.sub(r"\bclip\d+\b", lambda found: clips.get(found[0], found[0]), svg)

    def save(self, *paths: str | Path) -> str:
        """Draw it on white into files, by their ending .svg or .png; returns the drawing without a background."""
        svg = self.svg()
        white = on_white(svg)
        for path in map(Path, paths):
            if path.suffix == ".png":
                write_atomically(path, lambda stream: stream.write(vl_convert.svg_to_png(white, scale=PNG_SCALE)))
            else:
                write_text(path, white)
        return svg

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        return {"application/vnd.vegalite.v6+json": self.spec, "image/svg+xml": on_white(self.svg())}


def limit_of(curves: Iterable[Curve], spread: float = 10.0) -> Limit:
    """End of an axis for curves, see `shared_limit`."""
    return shared_limit({curve.key: peak(curve.y) for curve in curves}, spread)


def ends_of(curves: Iterable[Curve]) -> list[FloatArray]:
    """Ends of the intervals of curves."""
    return [np.asarray(end, dtype=np.float64) for curve in curves for end in (curve.low, curve.high)]


def on_white(svg: str) -> str:
    """The SVG document with a white sheet below everything."""
    return re.sub(r"(<svg[^>]*>)", r'\1<rect width="100%" height="100%" fill="#ffffff"/>', svg, count=1)


def figure(
    panels: Sequence[Panel],
    series: Mapping[str, str] | None = None,
    *,
    columns: int = 0,
    row: float = 66.0,
    column: float = 62.0,
) -> Chart:
    """Put panels side by side into one chart.

    Parameters
    ----------
    panels : sequence of Panel
        From left to right, row by row.
    series : mapping of str to str, optional
        Series that the page offers to switch, with their colours.
    columns : int
        Panels in a row; 0: all.
    row, column : float
        Between the fields of two panels, px.
    """
    data: Spec = {}
    views = [with_shared_data(panel.layered(number), data) for number, panel in enumerate(panels)]
    keys = [{"name": name, "colour": colour} for name, colour in (series or {}).items()]
    return Chart(
        {
            "$schema": "https://vega.github.io/schema/vega-lite/v6.json",
            "config": THEME,
            "usermeta": {"series": keys},
            "params": [{"name": "hidden", "value": []}, {"name": "live", "value": False}],
            "datasets": data,
            "concat": views,
            "columns": columns or len(panels),
            "bounds": "flush",
            "spacing": {"row": row, "column": column},
        }
    )


# ---- rows of data ---------------------------------------------------------------------------------------------------


def _by(curves: Iterable[Curve], kind: Callable[[Curve], _Kind]) -> list[tuple[_Kind, list[Curve]]]:
    """The curves of each kind, for layers of their own."""
    groups: dict[_Kind, list[Curve]] = {}
    for curve in curves:
        groups.setdefault(kind(curve), []).append(curve)
    return list(groups.items())


def _known(curve: Curve) -> IntArray:
    finite = np.isfinite(np.asarray(curve.x, dtype=np.float64)) & np.isfinite(np.asarray(curve.y, dtype=np.float64))
    return np.asarray(np.flatnonzero(finite), dtype=np.int64)


def _numbers(values: ArrayLike, kept: IntArray) -> list[float | None]:
    numbers = np.asarray(values, dtype=np.float64)[kept]
    return [short(value) if np.isfinite(value) else None for value in numbers.tolist()]
