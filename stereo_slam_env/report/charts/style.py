"""Colours that mean one thing everywhere, and limits and numbers that keep charts readable.

Charts are drawn in the light colours below; a page puts CSS variables in their place, so that one drawing serves light
and dark.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

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
    others = [name for name in distinct if name not in _RESERVED]
    slots = _RESERVED | {name: free[i % len(free)] for i, name in enumerate(others)}
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
    known = {name: peak for name, peak in peaks.items() if np.isfinite(peak) and peak > 0}
    if not known:
        return Limit(1.0, {})
    allowed = spread * min(known.values())
    upper = max(peak for peak in known.values() if peak <= allowed)
    return Limit(upper, {name: peak for name, peak in known.items() if peak > allowed})


def short_number(value: float) -> str:
    """Write a number with two digits that count: 0.083, 27, 150,000, 1.4·10⁹."""
    return readable(float(f"{value:.2g}"), ".2g")
