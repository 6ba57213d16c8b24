"""Look and axes of charts: colours that mean one thing everywhere, limits, labels, layers of Vega-Lite.

Charts are drawn in the light colours below; a page puts CSS variables in their place, so that one drawing serves light
and dark.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy  # its `optimize`, slow to import, is loaded where it is used
from numpy.typing import ArrayLike

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.figures import readable

PAPER = "#ffffff"
"""Behind everything."""
INK = "#1b1f24"
"""Text and ground truth."""
MUTED = "#6a717a"
"""Axis labels, raw measurements."""
GRID = "#e4e7eb"
"""Grid and axis lines."""
BAND = "#dde3ea"
"""Expected range (chi-square bands)."""

# Okabe and Ito's colour-blind-safe set, darkened where a thin line on white needs it.
_HUES = ("#0072b2", "#d55e00", "#009e73", "#a3458f", "#a67c00", "#4597c9", "#7a5c48", "#5b6bb5")
_DARKER = ("#004973", "#893d00", "#006649", "#692c5c", "#6a4f00", "#2c6181", "#4e3b2e", "#3a4574")
_LIGHTER = ("#4d9dc9", "#e28e4d", "#4dbb9d", "#be7cb0", "#c0a34d", "#7cb6d9", "#a28d7f", "#8c97cb")
PALETTE = (*_HUES, *_DARKER, *_LIGHTER)
"""Hues, then two shades of each that have dashes and a shape of their own: hue tells no more than eight apart."""
_DASHES = ((), (6.0, 3.0), (1.5, 2.5))
_SHAPES = ("circle", "square", "triangle-up")
_RESERVED = {"inverse-depth": 0, "dual-bearing": 1, "euclidean": 2}

CSS_VARIABLES = {PAPER: "--page", INK: "--ink", MUTED: "--muted", GRID: "--grid", BAND: "--band"} | {
    colour: f"--series-{i}" for i, colour in enumerate(PALETTE)
}
"""Drawing colour -> name of the CSS variable that takes its place in a page."""


def in_page_colours(text: str) -> str:
    """Put the CSS variables of the page in the place of the drawing colours."""
    for colour, variable in CSS_VARIABLES.items():
        text = text.replace(colour, f"var({variable})")
    return text


def filter_colours(names: Iterable[str]) -> dict[str, str]:
    """Give each filter one colour, whatever the order of `names`; the standard three keep theirs, unless not there."""
    names = list(names)
    distinct = sorted(set(names))
    free = [i for i in range(len(_HUES)) if i not in _RESERVED.values()]
    free += [slot for name, slot in _RESERVED.items() if name not in distinct]  # last, so that few change nothing
    free += range(len(_HUES), len(PALETTE))
    unreserved = [name for name in distinct if name not in _RESERVED]
    slots = _RESERVED | {name: free[i % len(free)] for i, name in enumerate(unreserved)}
    return {name: PALETTE[slots[name]] for name in dict.fromkeys(names)}


def dash_of(colour: str) -> tuple[float, ...]:
    """Dashes of lines in a colour, px; none where the hue is enough."""
    return _DASHES[_shade(colour)]


def shape_of(colour: str) -> str:
    """Shape of dots in a colour, as Vega names it."""
    return _SHAPES[_shade(colour)]


def _shade(colour: str) -> int:
    return PALETTE.index(colour) // len(_HUES) if colour in PALETTE else 0


def nested_widths(count: int) -> list[float]:
    """Line widths from broad to fine: of curves on top of each other, each one still shows."""
    if count < 2:
        return [1.8]
    step = min(1.5, 12.0 / (count - 1))
    return [1.4 + step * (count - 1 - i) for i in range(count)]


class Limit(NamedTuple):
    """End of an axis, and the filters that go beyond it, with their values."""

    upper: float
    beyond: dict[str, float]

    def note(self, unit: str = "") -> str:
        """Note above the panel: "↑ euclidean to 27 m", of more than two "↑ 3 filters to 27 m at the most", or ""."""
        if len(self.beyond) > 2:  # their names would run into the title
            return f"↑ {len(self.beyond)} filters to {short_number(max(self.beyond.values()))}{unit} at the most"
        far = ", ".join(f"{name} to {short_number(peak)}{unit}" for name, peak in self.beyond.items())
        return f"↑ {far}" if far else ""

    def note_colour(self, colours: Mapping[str, str]) -> str:
        """Of the filter that goes beyond, where it is only one."""
        return colours[next(iter(self.beyond))] if len(self.beyond) == 1 else MUTED


def shared_limit(peaks: Mapping[str, float], spread: float = 10.0) -> Limit:
    """Find the end of an axis so that one diverged filter does not flatten the others.

    `peaks` has the largest value of each filter, of which those that are not finite and positive are left out; filters
    whose peak is more than `spread` times the smallest one go beyond the axis.
    """
    finite = {name: peak for name, peak in peaks.items() if np.isfinite(peak) and peak > 0}
    if not finite:
        return Limit(1.0, {})
    allowed = spread * min(finite.values())
    upper = max(peak for peak in finite.values() if peak <= allowed)
    return Limit(upper, {name: peak for name, peak in finite.items() if peak > allowed})


def short_number(value: float) -> str:
    """Write a number with two digits that count: 0.083, 27, 150,000, 1.4·10⁹."""
    return readable(float(f"{value:.2g}"), ".2g")


WIDTH = 1170.0
"""Of a chart that fills the page, pixels."""


@dataclass(frozen=True)
class Axis:
    """A numeric axis with fixed ends."""

    low: float
    """Lower end, in the units of the data."""
    high: float
    """Upper end, in the units of the data."""
    title: str = ""
    """Title, with its unit."""
    log: bool = False
    """Whether it is logarithmic."""
    reverse: bool = False
    """Whether it goes from high to low."""
    ticks: Sequence[float] | None = None
    """Where to write numbers, instead of round ones; () for none."""
    grid: bool = True
    """Lines at the ticks."""

    @classmethod
    def of_rows(cls, count: int) -> Axis:
        """An axis of named rows at 0, 1, ... from top to bottom."""
        return cls(-0.5, count - 0.5, ticks=(), reverse=True)

    def share(self, value: float) -> float:
        """Position of a value between both ends, 0 to 1 (beyond them: less or more)."""
        ends = np.array([self.low, self.high, value], dtype=np.float64)
        low, high, at = np.log(np.maximum(ends, 1e-300)) if self.log else ends
        share = float((at - low) / (high - low)) if high > low else 0.5
        return 1.0 - share if self.reverse else share

    def within(self, values: ArrayLike) -> FloatArray:
        """Values, those far beyond the ends taken to where renderers still have coordinates."""
        reach = np.inf if self.log else 1e4 * (self.high - self.low)
        return np.clip(np.asarray(values, dtype=np.float64), self.low - reach, self.high + reach)

    def channel(self, name: str, cells: int) -> dict[str, Any]:
        """The encoding of a field on this axis, with about so many ticks."""
        ticks = log_ticks(self.low, self.high) if self.ticks is None and self.log else self.ticks
        scale: dict[str, Any] = {"domain": [short(self.low), short(self.high)], "nice": False, "reverse": self.reverse}
        axis: dict[str, Any] = {"grid": self.grid, "labelOverlap": True}
        if self.ticks == ():
            axis["titlePadding"] = 24  # below the names of `column_names`
        axis |= {"tickCount": cells} if ticks is None else {"values": [short(tick) for tick in ticks]}
        return {
            "field": name,
            "type": "quantitative",
            "title": self.title or None,
            "scale": scale | ({"type": "log"} if self.log else {"type": "linear", "zero": False}),
            "axis": axis | ({"format": "~g"} if self.log else {}),
        }


def log_ticks(low: float, high: float) -> list[float]:
    """Round numbers for a logarithmic axis: 0.1, 0.2, 0.5, 1, ...; powers of ten on a long one, fifths on a short."""
    if high < 4 * low:
        step = 10.0 ** np.floor(np.log10(high - low))
        step *= next(factor for factor in (0.1, 0.2, 0.5, 1.0, 2.0) if (high - low) / (factor * step) <= 6)
        return [float(tick) for tick in step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)]
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    every = max(1, round(len(decades) / 9))
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0) if high < 12 * low else (1.0, 2.0, 5.0) if high < 500 * low else (1.0,)
    ticks = [factor * 10.0**decade for decade in decades[::every] for factor in steps]
    return [tick for tick in ticks if low * 0.999 <= tick <= high * 1.001]


def log_axis(values: Iterable[FloatArray], title: str = "") -> Axis:
    """A logarithmic axis around everything positive."""
    everything = np.concatenate([np.ravel(value) for value in values] or [np.zeros(0)])
    positive = everything[np.isfinite(everything) & (everything > 0)]
    low, high = (float(positive.min()), float(positive.max())) if positive.size else (0.1, 1.0)
    margin = max((high / low) ** 0.07, 1.05)
    return Axis(low / margin, high * margin, title, log=True)


def panel_width(count: int, right: float, gap: float = 62.0, left: float = 46.0) -> float:
    """Width of each of `count` panels that fill a row, with room for labels on the right, px."""
    return (WIDTH - left - right - gap * (count - 1)) / count


def label_room(names: Iterable[str]) -> float:
    """Width that the longest of the names takes beside a panel, px."""
    return min(12.0 + 6.2 * max((len(name) for name in names), default=0), 330.0)


def spread_out(wanted: Sequence[float], gap: float) -> FloatArray:
    """Places at least `gap` apart in the ascending order of `wanted`, nearest in least squares."""
    if len(wanted) < 2:
        return np.asarray(wanted, dtype=np.float64)
    offsets = gap * np.arange(len(wanted))
    # With places = offsets + t, "at least gap apart" reads "t does not decrease".
    places: FloatArray = np.asarray(
        scipy.optimize.isotonic_regression(np.asarray(wanted) - offsets).x, dtype=np.float64
    )
    return np.asarray(places + offsets)


def short(value: float) -> float:
    """Five digits that count: more than a screen shows."""
    return float(f"{value:.5g}")


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
        name = next((key for key, other in data.items() if other == rows), f"rows_{len(data)}")
        data[name] = rows
        layers.append(layer | {"data": {"name": name}})
    return view | {"layer": layers}
