"""Figures of the map: how wrong landmarks are by distance, and how their depth converges with age."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stereo_slam_env.evaluation.consistency_figures import DOF
from stereo_slam_env.evaluation.landmark_statistics import DepthConvergence, RangeError
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.style import (
    MUTED,
    WIDTH_INCHES,
    EndLabel,
    colour_key,
    filter_colours,
    label_ends,
    plain_log_axis,
    styled,
)


@styled
def plot_landmark_errors(summaries: Sequence[FilterSummary]) -> Figure:
    """Error, depth bias and NEES of landmarks by their true distance.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        With `landmark_by_range`.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels; the bias with its standard error over runs.
    """
    shown = [s for s in summaries if s.landmark_by_range]
    colours = filter_colours(s.filter_name for s in summaries)
    ranges = list(dict.fromkeys((e.low_m, e.high_m) for s in shown for e in s.landmark_by_range))
    figure = Figure(figsize=(WIDTH_INCHES, 3.1))
    figure.subplots_adjust(left=0.05, right=0.87, top=0.9, bottom=0.17, wspace=0.22)
    error, bias, nees = figure.subplots(1, 3, sharex=True)
    _draw_by_range(error, shown, colours, lambda e: (e.rmse_m, np.nan))
    _draw_by_range(bias, shown, colours, lambda e: (e.depth_bias_m, e.depth_bias_sigma_m))
    _draw_by_range(nees, shown, colours, lambda e: (e.anees / DOF["landmark"], np.nan))
    bias.axhline(0, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
    nees.axhline(1, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
    error.set_yscale("log")
    plain_log_axis(error)
    values = [e.anees / DOF["landmark"] for s in shown for e in s.landmark_by_range if np.isfinite(e.anees)]
    if values and max(values) > 30 * min(values):
        nees.set_yscale("log")
        plain_log_axis(nees)
    else:
        nees.set_ylim(0, 1.15 * max([*values, 1.0]))
    error.set_title("Landmark RMSE (m)")
    bias.set_title("Depth bias ± standard error (m)")
    nees.set_title("Landmark NEES / 3 (1 is ideal)")
    for ax in (error, bias, nees):
        ax.set_xticks(range(len(ranges)), [_range_name(low, high) for low, high in ranges])
        ax.set(xlabel="true distance from the camera (m)", xlim=(-0.5, len(ranges) - 0.5))
    colour_key(nees, {s.filter_name: colours[s.filter_name] for s in shown})
    return figure


@styled
def plot_depth_convergence(summaries: Sequence[FilterSummary]) -> Figure:
    """Depth by the frames since a landmark entered the map: the claimed sigma, and the true error.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        With `depth_convergence`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for near landmarks, one for far ones.
    """
    shown = [s for s in summaries if s.depth_convergence]
    colours = filter_colours(s.filter_name for s in summaries)
    kinds = list(dict.fromkeys((c.label, c.low_m, c.high_m) for s in shown for c in s.depth_convergence))
    figure = Figure(figsize=(WIDTH_INCHES, 3.3))
    figure.subplots_adjust(left=0.06, right=0.87, top=0.9, bottom=0.15, wspace=0.42 if len(kinds) > 1 else 0.2)
    panels = figure.subplots(1, len(kinds), squeeze=False)[0]
    for ax, (label, low, high) in zip(panels, kinds, strict=True):
        ends = []
        for s in shown:
            for convergence in s.depth_convergence:
                if convergence.label == label:
                    ends.append(_draw_convergence(ax, s.filter_name, convergence, colours[s.filter_name]))
        ax.set_yscale("log")
        plain_log_axis(ax)
        ax.set_title(f"{label.capitalize()}, {low:g} to {high:g} m: σ solid, error dashed (m)")
        ax.set_xlabel("frames since it entered the map")
        label_ends(ax, ends)
    return figure


def _draw_by_range(
    ax: Axes,
    summaries: Sequence[FilterSummary],
    colours: dict[str, str],
    value: Callable[[RangeError], tuple[float, float]],
) -> None:
    """Points of each range side by side, so that none hides another one."""
    ranges = list(dict.fromkeys((e.low_m, e.high_m) for s in summaries for e in s.landmark_by_range))
    offsets = 0.14 * (np.arange(len(summaries)) - 0.5 * (len(summaries) - 1))
    for s, offset in zip(summaries, offsets, strict=True):
        points = np.array([(ranges.index((e.low_m, e.high_m)), *value(e)) for e in s.landmark_by_range if e.count])
        if not len(points):
            continue
        places, values, sigmas = points.T
        known = np.isfinite(values)
        spans = np.where(np.isfinite(sigmas), sigmas, 0.0)[known]
        ax.errorbar(
            (places + offset)[known],
            values[known],
            yerr=spans if spans.any() else None,
            color=colours[s.filter_name],
            marker="o",
            markersize=4.5,
            linewidth=0.8,
            elinewidth=1.3,
            label=s.filter_name,
        )


def _draw_convergence(ax: Axes, name: str, convergence: DepthConvergence, colour: str) -> EndLabel:
    sigma, rmse = np.array(convergence.sigma_m), np.array(convergence.rmse_m)
    ax.plot(convergence.frames, sigma, color=colour, linewidth=1.5, label=name)
    ax.plot(convergence.frames, rmse, color=colour, linewidth=1.1, linestyle="--", label=f"{name} | true error")
    return EndLabel(name, series.last_known(sigma), colour)


def _range_name(low: float, high: float) -> str:
    return f"{low:g}–{high:g}" if np.isfinite(high) else f"> {low:g}"
