"""Figures of accuracy beyond the trajectory: relative errors by length, and the distance from what theory allows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from filters.validation import FloatArray
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary, SegmentError
from stereo_slam_env.evaluation.run_figures import Bounds
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.style import (
    INK,
    MUTED,
    WIDTH_INCHES,
    EndLabel,
    filter_colours,
    label_ends,
    name_rows,
    note_beyond,
    plain_log_axis,
    shared_limit,
    styled,
)

_SegmentValue = Callable[[SegmentError], float]


@styled
def plot_segment_errors(summaries: Sequence[FilterSummary]) -> Figure:
    """Relative errors over segments of the path, by their length, as KITTI measures them.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        With `rpe`.

    Returns
    -------
    matplotlib.figure.Figure
        Translation in % of the length, rotation in degrees per 100 m.
    """
    shown = [s for s in summaries if s.rpe]
    colours = filter_colours(s.filter_name for s in summaries)
    figure = Figure(figsize=(WIDTH_INCHES, 2.9))
    figure.subplots_adjust(left=0.06, right=0.87, top=0.89, bottom=0.17, wspace=0.2)
    translation, rotation = figure.subplots(1, 2, sharex=True)
    _draw_segments(translation, shown, colours, lambda error: error.translation_percent)
    labels = _draw_segments(rotation, shown, colours, lambda error: error.rotation_deg_per_100m)
    translation.set_title("Translation error over a segment (%)")
    rotation.set_title("Rotation error over a segment (°/100m)")
    for ax in (translation, rotation):
        ax.set_xlabel("length of the segment (m)")
    label_ends(rotation, labels)
    return figure


def _draw_segments(
    ax: Axes, summaries: Sequence[FilterSummary], colours: Mapping[str, str], value: _SegmentValue
) -> list[EndLabel]:
    curves = {s.filter_name: np.array([(e.length_m, value(e)) for e in s.rpe]) for s in summaries}
    limit = shared_limit({name: series.peak(curve[:, 1]) for name, curve in curves.items()})
    for name, curve in curves.items():
        ax.plot(*curve.T, color=colours[name], marker="o", markersize=4, label=name)
    ax.set_ylim(0, 1.12 * limit.upper)
    note_beyond(ax, limit, colours)
    inside = {name: curve for name, curve in curves.items() if name not in limit.beyond}
    return [EndLabel(name, series.last_known(curve[:, 1]), colours[name]) for name, curve in inside.items()]


@styled
def plot_efficiency(summaries: Sequence[FilterSummary]) -> Figure:
    """Bound / RMSE of each run: 100 % leaves nothing to gain on average.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        With `efficiency_percent`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = [s for s in summaries if s.efficiency_percent is not None]
    colours = filter_colours(s.filter_name for s in summaries)
    figure = Figure(figsize=(WIDTH_INCHES, 0.9 + 0.42 * len(shown)))
    height = figure.get_figheight()
    ax = figure.add_axes((0.15, 0.5 / height, 0.82, 1 - 0.6 / height))
    ax.axvline(100, color=MUTED, linewidth=0.9, linestyle=(0, (4, 3)), zorder=0)
    for row, s in enumerate(shown):
        single = np.array([e for e in s.efficiency_by_run if np.isfinite(e) and e > 0])
        colour, name = colours[s.filter_name], s.filter_name
        ax.scatter(single, [row] * len(single), s=24, alpha=0.55, color=colour, linewidths=0, label=name)
        ax.plot([s.efficiency_percent or np.nan], [row], color=INK, marker="|", markersize=14, label="over all runs")
    everything = np.array([e for s in shown for e in (*s.efficiency_by_run, s.efficiency_percent) if e and e > 0])
    everything = everything[np.isfinite(everything)]
    if everything.size and everything.max() > 30 * everything.min():
        ax.set_xscale("log")
        plain_log_axis(ax, "x")
    else:
        ax.set_xlim(0, 1.05 * max(100.0, series.peak(everything)))
    ax.set(xlabel="bound / position RMSE of each run (%)", ylim=(len(shown) - 0.5, -0.5))
    name_rows(ax, [s.filter_name for s in shown], colours)
    return figure


@styled
def plot_error_against_bound(runs: Sequence[FilterRun], bounds: Bounds) -> Figure:
    """Root mean square error over runs, frame by frame, above the posterior Cramer-Rao bound.

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs whose recording has no bound are left out.
    bounds : mapping
        By (recording_name, seed).

    Returns
    -------
    matplotlib.figure.Figure
        Position and rotation.

    Raises
    ------
    ValueError
        No run has a bound.
    """
    bounded = [run for run in runs if (run.recording_name, run.seed) in bounds]
    if not bounded:
        raise ValueError("bounds must have the recording of at least one of the runs")
    groups = series.by_filter(bounded)
    colours = filter_colours(series.by_filter(runs))
    frames = max(len(run) for run in bounded)
    time = series.elapsed(max(bounded, key=len))
    recordings = dict.fromkeys((run.recording_name, run.seed) for run in bounded)
    figure = Figure(figsize=(WIDTH_INCHES, 3.1))
    figure.subplots_adjust(left=0.06, right=0.87, top=0.9, bottom=0.16, wspace=0.2)
    panels = figure.subplots(1, 2, sharex=True)
    kinds = (
        ("Position RMSE over runs (m)", slice(0, 3), 1.0),
        ("Rotation RMSE over runs (°)", slice(3, 6), 180 / np.pi),
    )
    for ax, (title, part, scale) in zip(panels, kinds, strict=True):
        limit_line = scale * np.sqrt(_mean_trace([bounds[key] for key in recordings], part, frames))
        curves = {
            name: scale * np.sqrt(series.column_mean(series.stack(group, _squared_error(part), frames)))
            for name, group in groups.items()
        }
        limit = shared_limit({name: series.peak(curve) for name, curve in curves.items()}, spread=20.0)
        for name, curve in curves.items():
            ax.plot(time, curve, color=colours[name], linewidth=1.3, label=name)
        ax.plot(time, limit_line, color=INK, linewidth=1.6, linestyle=(0, (4, 2)), label="limit")
        ax.set(title=title, xlabel="time (s)", xlim=(0, time[-1]), ylim=(0, 1.1 * limit.upper))
        note_beyond(ax, limit, colours)
        labels = [EndLabel(name, series.last_known(curve), colours[name]) for name, curve in curves.items()]
        labels.append(EndLabel("limit", series.last_known(limit_line), INK))
        if ax is panels[-1]:
            label_ends(ax, [label for label in labels if label.text not in limit.beyond])
    return figure


def _mean_trace(bounds: Sequence[Bound], part: slice, frames: int) -> FloatArray:
    """Mean over recordings of the trace of a block of the bound; (K,)."""
    table = np.full((len(bounds), frames), np.nan)
    for row, bound in zip(table, bounds, strict=True):
        row[: len(bound.pose)] = np.trace(bound.pose[:, part, part], axis1=1, axis2=2)
    return series.column_mean(table)


def _squared_error(part: slice) -> series.Quantity:
    return lambda run: np.asarray((series.belief_error(run)[0][:, part] ** 2).sum(axis=1))
