"""Axes of charts, and where things go on and beside them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its `optimize`, slow to import, is loaded where it is used
from numpy.typing import ArrayLike

from filters.geometry.arrays import FloatArray

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
        shown: dict[str, Any] = {"grid": self.grid, "labelOverlap": True}
        if self.ticks == ():
            shown["titlePadding"] = 24  # below the names of `column_names`
        shown |= {"tickCount": cells} if ticks is None else {"values": [short(tick) for tick in ticks]}
        return {
            "field": name,
            "type": "quantitative",
            "title": self.title or None,
            "scale": scale | ({"type": "log"} if self.log else {"type": "linear", "zero": False}),
            "axis": shown | ({"format": "~g"} if self.log else {}),
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
    known = everything[np.isfinite(everything) & (everything > 0)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.1, 1.0)
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
