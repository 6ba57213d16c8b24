"""Small pieces of HTML by which result objects show themselves in a notebook (`_repr_html_`); nothing is fetched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from filters.contract.validation import without_controls
from filters.geometry.arrays import FloatArray

_CELL = "text-align:left;padding:1px 10px 1px 0;vertical-align:top"

_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#8c564b", "#b8860b")
_DASHES = ("none", "6 3", "1.5 2.5")


def heading(text: str) -> str:
    """Heading as HTML, escaped."""
    return f"<h4>{_plain(text)}</h4>"


def paragraph(text: str) -> str:
    """Paragraph as HTML, escaped."""
    return f"<p>{_plain(text)}</p>"


def fixed_width(text: str) -> str:
    """Text with its columns."""
    return f'<pre style="font-family:monospace;line-height:1.25">{_plain(text)}</pre>'


def facts(rows: Mapping[str, str]) -> str:
    """A table of names and values."""
    body = "".join(
        f'<tr><th style="{_CELL}">{_plain(k)}</th><td style="{_CELL}">{_plain(v)}</td></tr>' for k, v in rows.items()
    )
    return f"<table>{body}</table>"


def lines_chart(series: Mapping[str, tuple[FloatArray, FloatArray]], x: str, y: str, *, equal: bool = False) -> str:
    """Lines of (x, y) with their names beside them, as SVG; a point shows its values where the pointer rests.

    With `equal`, both axes have one scale, as a path seen from above needs. More lines than colours are dashed.
    """
    width, height, edge = 420.0, 260.0, 44.0
    finite_points = [np.column_stack(pair)[np.isfinite(np.column_stack(pair)).all(axis=1)] for pair in series.values()]
    points = np.concatenate([*finite_points, np.zeros((0, 2))])
    if not len(points):
        return ""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    scale = np.array([width - 2 * edge, height - 2 * edge]) / span
    scale = np.full(2, scale.min()) if equal else scale
    drawn = []
    for at, (name, line) in enumerate(zip(series, finite_points, strict=True)):
        colour, dashes = _COLOURS[at % len(_COLOURS)], _DASHES[at // len(_COLOURS) % len(_DASHES)]
        pixels = np.column_stack(
            [edge + scale[0] * (line[:, 0] - low[0]), height - edge - scale[1] * (line[:, 1] - low[1])]
        )
        path = " ".join(f"{u:.1f},{v:.1f}" for u, v in pixels)
        stroke = f'stroke="{colour}" stroke-width="1.5" stroke-dasharray="{dashes}"'
        drawn.append(f'<polyline points="{path}" fill="none" {stroke}/>')
        every = max(1, len(line) // 60)
        for (u, v), (a, b) in zip(pixels[::every].tolist(), line[::every].tolist(), strict=True):
            about = f"<title>{_plain(name)}: {a:.4g}, {b:.4g}</title>"
            drawn.append(
                f'<circle cx="{u:.1f}" cy="{v:.1f}" r="3" fill="{colour}" fill-opacity="0.35">{about}</circle>'
            )
        down = 14 + 15 * at
        drawn.append(f'<line x1="{width:.0f}" x2="{width + 22:.0f}" y1="{down - 4}" y2="{down - 4}" {stroke}/>')
        drawn.append(f'<text x="{width + 27:.0f}" y="{down}" font-size="11" fill="{colour}">{_plain(name)}</text>')
    axes = _axes(low, high, scale, (width, height, edge), x, y)
    room = 40.0 + 6.5 * max(len(name) for name in series)
    size = f'width="{width + room:.0f}" height="{max(height, 20.0 + 15.0 * len(series)):.0f}"'
    return f'<svg {size} style="background:#fff">{axes}{"".join(drawn)}</svg>'


def dots(points: FloatArray, size: tuple[int, int], about: Sequence[str]) -> str:
    """Points (N, 2) in an image of a size, px, as SVG; each shows its text where the pointer rests."""
    width = 420.0
    scale = width / size[0]
    drawn = [
        f'<circle cx="{scale * u:.1f}" cy="{scale * v:.1f}" r="3" fill="#d62728"><title>{_plain(text)}</title></circle>'
        for (u, v), text in zip(points.tolist(), about, strict=True)
    ]
    height = scale * size[1]
    return f'<svg width="{width:.0f}" height="{height:.0f}" style="background:#eee">{"".join(drawn)}</svg>'


def _axes(
    low: FloatArray, high: FloatArray, scale: FloatArray, size: tuple[float, float, float], x: str, y: str
) -> str:
    """Both axes with round ticks, their grid, and their names."""
    width, height, edge = size
    style, grid = 'font-size="11" fill="#444"', 'stroke="#ddd" stroke-width="1"'
    parts = [
        f'<text x="{width - edge:.0f}" y="{height - 4:.0f}" text-anchor="end" {style}>{_plain(x)}</text>',
        f'<text x="4" y="14" {style}>{_plain(y)}</text>',
    ]
    for value in _ticks(low[0], high[0]):
        u = edge + scale[0] * (value - low[0])
        parts.append(f'<line x1="{u:.1f}" x2="{u:.1f}" y1="{edge / 2:.0f}" y2="{height - edge:.0f}" {grid}/>')
        parts.append(f'<text x="{u:.1f}" y="{height - edge + 14:.0f}" text-anchor="middle" {style}>{value:g}</text>')
    for value in _ticks(low[1], high[1]):
        v = height - edge - scale[1] * (value - low[1])
        parts.append(f'<line x1="{edge:.0f}" x2="{width - edge:.0f}" y1="{v:.1f}" y2="{v:.1f}" {grid}/>')
        parts.append(f'<text x="{edge - 5:.0f}" y="{v + 4:.1f}" text-anchor="end" {style}>{value:g}</text>')
    return "".join(parts)


def _ticks(low: float, high: float) -> list[float]:
    """Three to six round numbers between two."""
    rough = max(high - low, 1e-9) / 4.0
    unit = 10.0 ** np.floor(np.log10(rough))
    step = unit * min((1.0, 2.0, 5.0, 10.0), key=lambda factor: abs(np.log(factor * unit / rough)))
    return [float(f"{step * k:.6g}") for k in range(int(np.ceil(low / step - 1e-9)), int(high / step + 1e-9) + 1)]


def _plain(text: str) -> str:
    return escape(without_controls(text))
