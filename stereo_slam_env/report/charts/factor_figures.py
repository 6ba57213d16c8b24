"""Figures of studies: how a response depends on a factor, and which choice of a filter makes the difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from filters.validation import FloatArray
from stereo_slam_env.benchmark.statistics.attribution import Attribution, Effect, ResponseAttribution
from stereo_slam_env.benchmark.statistics.comparison import Change
from stereo_slam_env.report.charts.style import (
    BAND,
    INK,
    MUTED,
    PALETTE,
    WIDTH_INCHES,
    colour_key,
    filter_colours,
    plain_log_axis,
    styled,
)


@dataclass(frozen=True, eq=False)
class FactorResponse:
    """One response of every filter at every level of a factor.

    Attributes
    ----------
    title : str
        With its unit in brackets.
    means, lows, highs : mapping of str to (L,) ndarray
        Of each filter: mean over seeds and the other factors, and its interval; NaN where not known.
    band : pair of float, optional
        Where a consistent filter would be.
    log : bool
        Whether the axis is logarithmic.
    """

    title: str
    means: Mapping[str, FloatArray]
    lows: Mapping[str, FloatArray]
    highs: Mapping[str, FloatArray]
    band: tuple[float, float] | None = None
    log: bool = True


@styled
def plot_factor(factor: str, levels: Sequence[Any], responses: Sequence[FactorResponse]) -> Figure:
    """Draw every response against the levels of a factor, one line for each filter.

    Parameters
    ----------
    factor : str
        Name, below the panels.
    levels : sequence
        Numbers are drawn to scale, anything else side by side.
    responses : sequence of FactorResponse
        One panel each.

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = list(dict.fromkeys(name for response in responses for name in response.means))
    colours = filter_colours(names)
    to_scale = all(isinstance(level, (int, float)) and not isinstance(level, bool) for level in levels)
    places = np.array(levels, dtype=np.float64) if to_scale else np.arange(float(len(levels)))
    longest = 0 if to_scale else max(len(str(level)) for level in levels)
    tilted = len(levels) * longest > 40
    extra = 0.03 * longest if tilted else 0.0
    height = 3.2 + extra
    figure = Figure(figsize=(WIDTH_INCHES, height))
    figure.subplots_adjust(left=0.06, right=0.85, top=1 - 0.34 / height, bottom=(0.5 + extra) / height, wspace=0.22)
    panels = figure.subplots(1, len(responses), sharex=True, squeeze=False)[0]
    for ax, response in zip(panels, responses, strict=True):
        if to_scale and places.min() > 0 and places.max() > 8 * places.min():
            ax.set_xscale("log")
        _draw_response(ax, places, response, names, colours, joined=to_scale)
        if to_scale:
            ax.set_xlabel(factor)
            ax.set_xticks(places, [f"{place:g}" for place in places])
            ax.xaxis.set_minor_locator(NullLocator())
        else:
            ax.set_xticks(places, [str(level) for level in levels], rotation=30 if tilted else 0)
            ax.set_xlim(-0.5, len(levels) - 0.5)
            if not tilted:
                ax.set_xlabel(factor)
    colour_key(panels[-1], {name: colours[name] for name in names[:18]})
    return figure


def _draw_response(
    ax: Axes,
    places: FloatArray,
    response: FactorResponse,
    names: Sequence[str],
    colours: Mapping[str, str],
    *,
    joined: bool,
) -> None:
    # Side by side, so that no interval hides another one.
    beside = np.linspace(-1.0, 1.0, len(names)) if len(names) > 1 else np.zeros(1)
    positions = [_beside(places, share, ax.get_xscale(), joined=joined) for share in beside]
    if response.band is not None:
        ax.axhspan(*response.band, color=BAND, linewidth=0, zorder=0)
    for name, x in zip(names, positions, strict=True):
        if name not in response.means:
            continue
        mean = response.means[name]
        known = np.isfinite(mean) & ((mean > 0) | (not response.log))
        if not known.any():
            continue
        low, high = (
            np.where(np.isfinite(ends), ends, mean)[known] for ends in (response.lows[name], response.highs[name])
        )
        spans = np.stack([mean[known] - low, high - mean[known]])
        ax.errorbar(
            x[known],
            mean[known],
            yerr=spans if spans.any() else None,
            color=colours[name],
            marker="o",
            markersize=4.5,
            linestyle="-" if joined else "none",
            linewidth=1.3,
            elinewidth=1.2,
            label=name,
        )
    ax.set_title(response.title)
    if response.log:
        ax.set_yscale("log")
        plain_log_axis(ax)
    else:
        ax.set_ylim(bottom=0)


def _beside(places: FloatArray, share: float, scale: str, *, joined: bool) -> FloatArray:
    if not joined:
        return places + 0.3 * share
    if scale == "log":
        return np.asarray(places * (places.max() / places.min()) ** (0.008 * share))
    return places + 0.008 * share * float(np.ptp(places))


@styled
def plot_effects(attribution: Attribution) -> Figure:
    """Main effects of every choice on every response, with their intervals.

    Parameters
    ----------
    attribution : Attribution
        Which choice makes the difference.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each response; 1 is the average over all combinations.
    """
    rows = [(factor, level) for factor, levels in attribution.factors.items() for level in levels]
    figure = Figure(figsize=(WIDTH_INCHES, 1.0 + 0.27 * len(rows)))
    height = figure.get_figheight()
    figure.subplots_adjust(left=0.21, right=0.97, top=1 - 0.36 / height, bottom=0.5 / height, wspace=0.1)
    panels = figure.subplots(1, len(attribution.responses), sharey=True, squeeze=False)[0]
    for ax, response in zip(panels, attribution.responses, strict=True):
        _draw_effects(ax, rows, response)
    panels[0].set_yticks(range(len(rows)), [f"{factor}: {level}" for factor, level in rows])
    panels[0].set_ylim(len(rows) - 0.5, -0.5)
    for ax in panels[1:]:
        ax.tick_params(labelleft=False)
    return figure


def _draw_effects(ax: Axes, rows: Sequence[tuple[str, Any]], response: ResponseAttribution) -> None:
    effects = {(effect.factors[0], effect.levels[0]): effect for effect in response.effects}
    start = 0
    for factor in dict.fromkeys(name for name, _ in rows):  # a rule between factors
        start += sum(name == factor for name, _ in rows)
        ax.axhline(start - 0.5, color=BAND, linewidth=0.8, zorder=0)
    for colour, shown, label in ((PALETTE[0], True, "effect shown"), (MUTED, False, "no effect shown")):
        chosen = [(i, effects[row]) for i, row in enumerate(rows) if row in effects and effects[row].shown == shown]
        if not chosen:
            continue
        ratio = np.array([1 + effect.percent / 100 for _, effect in chosen])
        ends = np.array([_ends(effect) for _, effect in chosen])
        spans = np.stack([ratio - ends[:, 0], ends[:, 1] - ratio])
        ax.barh([i for i, _ in chosen], ratio - 1, left=1, height=0.55, color=colour, alpha=0.35, label=f"_{label}")
        y = [i for i, _ in chosen]
        ax.errorbar(
            ratio, y, xerr=np.abs(spans), color=colour, marker="o", markersize=4.5, linestyle="none", label=label
        )
    ax.axvline(1, color=INK, linewidth=0.8)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.set_xlim(min(low, 0.98), max(high, 1.02))
    plain_log_axis(ax, "x")
    ax.set(title=response.response[:1].upper() + response.response[1:], xlabel="times the average")
    ax.grid(visible=False, axis="y")


def _ends(effect: Effect) -> tuple[float, float]:
    low, high = effect.interval_percent or (effect.percent, effect.percent)
    return 1 + low / 100, 1 + high / 100


@styled
def plot_changes(changes: Sequence[Change]) -> Figure:
    """Draw how much every measure of every filter changed, with its interval.

    Parameters
    ----------
    changes : sequence of Change
        Those without an interval are left out.

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = [change for change in changes if change.interval_percent is not None]
    names = list(dict.fromkeys(change.filter_name for change in shown))
    measures = list(dict.fromkeys(change.measure for change in shown))
    colours = filter_colours(names)
    figure = Figure(figsize=(WIDTH_INCHES, 0.9 + 0.16 * len(measures) * max(len(names), 2)))
    height = figure.get_figheight()
    ax = figure.add_axes((0.19, 0.5 / height, 0.66, 1 - 0.7 / height))
    for i, name in enumerate(names):
        own = [change for change in shown if change.filter_name == name]
        rows = [measures.index(change.measure) - 0.3 + 0.6 * (i + 0.5) / len(names) for change in own]
        ends = 1 + np.array([change.interval_percent for change in own], dtype=np.float64) / 100
        centres = np.sqrt(ends[:, 0] * ends[:, 1])
        spans = np.stack([centres - ends[:, 0], ends[:, 1] - centres])
        ax.errorbar(
            centres, rows, xerr=spans, color=colours[name], marker="o", markersize=4, linestyle="none", label=name
        )
    ax.axvline(1, color=INK, linewidth=0.8)
    ax.set_xscale("log")
    plain_log_axis(ax, "x")
    ax.set(xlabel="after / before; of consistency: distance from the ideal", ylim=(len(measures) - 0.5, -0.5))
    ax.set_yticks(range(len(measures)), measures)
    ax.grid(visible=False, axis="y")
    colour_key(ax, colours)
    return figure
