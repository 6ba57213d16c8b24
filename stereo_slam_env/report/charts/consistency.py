"""Figures of honesty: does a filter know how wrong it is? 3-sigma bounds, NEES, NIS, depth convergence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.style import (
    BAND,
    INK,
    MUTED,
    WIDTH_INCHES,
    EndLabel,
    colour_key,
    filter_colours,
    label_ends,
    nested_widths,
    note_beyond,
    plain_log_axis,
    shared_limit,
    short_number,
    styled,
)

POSE_DOF = 6

# The order of the panels; columns of the pose error. The camera frame is x right, y down, z forward: roll is about z.
_PANELS = (
    ("x", 0, "cm", 100.0),
    ("y", 1, "cm", 100.0),
    ("z", 2, "cm", 100.0),
    ("roll", 5, "°", 180.0 / np.pi),
    ("pitch", 3, "°", 180.0 / np.pi),
    ("yaw", 4, "°", 180.0 / np.pi),
)


def error_limits(runs: Sequence[FilterRun]) -> FloatArray:
    """Half heights (6,) that let the error figures of several filters be compared; m and rad.

    A diverged filter does not count: the others stay readable.
    """
    peaks = {run.filter_name: np.zeros(6) for run in runs}
    for run in runs:
        error, sigma = series.belief_error(run)
        reach = np.stack([np.abs(error), 3 * sigma])
        peaks[run.filter_name] = np.array([series.peak(reach[:, :, axis]) for axis in range(6)])
    limits = [shared_limit({n: float(p[axis]) for n, p in peaks.items()}).upper for axis in range(6)]
    return np.array(limits)


@styled
def plot_error_bounds(run: FilterRun, limits: FloatArray | None = None) -> Figure:
    """Pose error inside its claimed 3-sigma bounds, one panel per degree of freedom.

    Parameters
    ----------
    run : FilterRun
        One filter on one recording.
    limits : (6,) ndarray, optional
        Half heights from `error_limits`, to compare filters on equal scales.

    Returns
    -------
    matplotlib.figure.Figure
        Position (in W) in the upper row, rotation (camera frame) in the lower one.
    """
    colour = filter_colours([run.filter_name])[run.filter_name]
    limits = error_limits([run]) if limits is None else limits
    error, sigma = series.belief_error(run)
    time = series.elapsed(run)
    figure = Figure(figsize=(WIDTH_INCHES, 4.4))
    figure.subplots_adjust(left=0.045, right=0.99, top=0.87, bottom=0.1, hspace=0.36, wspace=0.14)
    figure.text(0.045, 0.975, run.filter_name, color=colour, fontweight="bold", fontsize=10, va="top")
    for ax, (title, axis, unit, scale) in zip(figure.subplots(2, 3, sharex=True).flat, _PANELS, strict=True):
        e, bound = scale * error[:, axis], 3 * scale * sigma[:, axis]
        known = np.isfinite(e)
        ax.fill_between(time, -bound, bound, color=colour, alpha=0.13, linewidth=0)
        for side in (-bound, bound):
            ax.plot(time, side, color=colour, alpha=0.45, linewidth=0.7, label="3σ")
        ax.plot(time[known], e[known], color=colour, linewidth=1.1, label="error")
        half = 1.12 * scale * limits[axis]
        ax.set(title=f"{title} ({unit})", ylim=(-half, half), xlim=(0, time[-1]))
        inside = known & np.isfinite(bound) & (bound > 0)
        share = f"{100 * np.mean(np.abs(e[inside]) <= bound[inside]):.0f} % inside ±3σ" if inside.any() else ""
        far = f"max {short_number(series.peak(e))} {unit}, " if series.peak(e) > half else ""
        ax.set_title(far + share, loc="right", color=MUTED, fontweight="normal", fontsize=8)
    for ax in figure.axes[3:]:
        ax.set_xlabel("time (s)")
    return figure


@styled
def plot_nees(runs: Sequence[FilterRun]) -> Figure:
    """NEES / 6 of the pose, averaged over runs, with its two-sided 95 % chi-square band.

    Parameters
    ----------
    runs : sequence of FilterRun
        Several recordings of each filter, ideally from simulation: the band holds for independent runs.

    Returns
    -------
    matplotlib.figure.Figure
    """
    tables = {
        name: series.stack(group, lambda run: run.pose_nees / POSE_DOF)
        for name, group in series.by_filter(runs).items()
    }
    curves = {name: series.column_mean(table) for name, table in tables.items()}
    most = max(tables.values(), key=lambda table: int(np.isfinite(table).sum()))
    count = np.isfinite(most).sum(axis=0)
    low, high = (end / POSE_DOF for end in _bands(POSE_DOF, count))
    time = series.elapsed(max(runs, key=len))
    figure = Figure(figsize=(WIDTH_INCHES, 3.3))
    ax = figure.add_axes((0.07, 0.14, 0.8, 0.76))
    runs_shown = int(count.max(initial=0))
    of_runs = f", mean of {runs_shown} runs" if runs_shown > 1 else ""
    ax.set_title(f"Pose NEES / 6{of_runs} (1 is ideal)")
    _draw_against_band(ax, time, curves, (low, high))
    return figure


@styled
def plot_nis(runs: Sequence[FilterRun], points: int = 80) -> Figure:
    """NIS per degree of freedom with its two-sided 95 % band, pooled over runs and short stretches of time.

    A consistent filter's innovations are white, so frames may be pooled (those of NEES may not).

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs of any number of filters and recordings.
    points : int
        Number of stretches the drive is cut into.

    Returns
    -------
    matplotlib.figure.Figure
    """
    time = series.elapsed(max(runs, key=len))
    starts = np.unique(np.linspace(0, len(time), min(points, len(time)) + 1).astype(int)[:-1])
    curves: dict[str, FloatArray] = {}
    dofs: list[FloatArray] = []
    for name, group in series.by_filter(runs).items():
        nis = series.stack(group, lambda run: run.nis, frames=len(time))
        dof = series.stack(group, lambda run: run.nis_dof.astype(np.float64), frames=len(time))
        dof[~np.isfinite(nis)] = 0.0
        sums = np.add.reduceat(np.nansum(nis, axis=0), starts)
        pooled = np.add.reduceat(np.nansum(dof, axis=0), starts)
        curves[name] = np.divide(sums, pooled, out=np.full(len(starts), np.nan), where=pooled > 0)
        dofs.append(pooled)
    low, high = _bands(1, np.min(dofs, axis=0))
    figure = Figure(figsize=(WIDTH_INCHES, 3.3))
    ax = figure.add_axes((0.07, 0.14, 0.8, 0.76))
    ax.set_title("NIS per degree of freedom (1 is ideal)")
    _draw_against_band(ax, time[starts], curves, (low, high))
    return figure


@styled
def plot_depth(runs: Sequence[FilterRun]) -> Figure:
    """Depth of a near and a far landmark on the first recording that has traces (the paper's Fig. 4 and 5).

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs with `traces`.

    Returns
    -------
    matplotlib.figure.Figure
        Estimates with ±1 sigma in the upper row, sigma in the lower one; one column per landmark.

    Raises
    ------
    ValueError
        No run has a trace.
    """
    shown = series.first_recording([run for run in runs if run.traces] or list(runs))
    colours = filter_colours(run.filter_name for run in runs)
    landmarks = list(dict.fromkeys((t.label, t.landmark_id) for run in shown for t in run.traces))[:2]
    if not landmarks:
        raise ValueError("runs must have at least one landmark trace to plot depth convergence")
    figure = Figure(figsize=(WIDTH_INCHES, 5.4))
    figure.subplots_adjust(left=0.06, right=0.87, top=0.95, bottom=0.085, hspace=0.3, wspace=0.42)
    panels = figure.subplots(2, len(landmarks), sharex="col", squeeze=False)
    for column, (label, landmark_id) in zip(panels.T, landmarks, strict=True):
        traces = {
            run.filter_name: trace
            for run in shown
            for trace in run.traces
            if trace.landmark_id == landmark_id and len(trace.frames)
        }
        if not traces:
            continue
        column[0].set_title(f"{label.capitalize()} landmark, depth ± 1σ (m)")
        column[1].set_title("σ of its depth (m)")
        _draw_depth(column[0], traces, colours)
        _draw_sigma(column[1], traces, colours)
        column[1].set_xlabel("frames since it was first seen")
    return figure


def _bands(dof: int, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the 95 % band of a mean of `counts` chi-square(dof) variables; NaN where a count is 0."""
    known = {float(n): mean_band(dof, int(n)) for n in np.unique(counts[counts > 0])}
    pairs = np.array([known.get(float(n), (np.nan, np.nan)) for n in counts])
    return pairs[:, 0], pairs[:, 1]


def _draw_against_band(
    ax: Axes,
    time: FloatArray,
    curves: dict[str, FloatArray],
    band: tuple[FloatArray, FloatArray],
) -> None:
    """Curves, of which 1 is ideal, on a log axis (twice too large and too small look alike) over the band."""
    low, high = band
    colours = filter_colours(curves)
    known = np.isfinite(low)
    ax.fill_between(time[known], low[known], high[known], color=BAND, linewidth=0, zorder=0, label="_95 % band")
    ax.plot(time, np.ones(len(time)), color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    ax.set_yscale("log")
    limit = shared_limit({name: series.peak(curve) for name, curve in curves.items()}, spread=100.0)
    labels = []
    for name, curve in curves.items():
        shown = np.isfinite(curve) & (curve > 0)
        ax.plot(time[shown], curve[shown], color=colours[name], linewidth=1.2, label=name)
        labels.append(EndLabel(name, series.last_known(curve), colours[name]))
    floor = min((float(np.percentile(c[c > 0], 1)) for c in curves.values() if (c > 0).any()), default=0.1)
    bottom = max(min(floor, float(low[known].min(initial=np.inf))), 0.02)
    top = max(limit.upper, float(high[known].max(initial=0.0)))
    margin = (top / bottom) ** 0.06
    ax.set(ylim=(bottom / margin, top * margin), xlim=(0, time[-1]), xlabel="time (s)")
    plain_log_axis(ax)
    note_beyond(ax, limit, colours)
    centre = float(np.sqrt(low[known][-1] * high[known][-1])) if known.any() else np.nan
    labels.append(EndLabel("95 % band", centre, MUTED))
    label_ends(ax, [label for label in labels if label.text not in limit.beyond])


def _draw_depth(ax: Axes, traces: dict[str, LandmarkTrace], colours: dict[str, str]) -> None:
    longest = max(traces.values(), key=lambda trace: len(trace.frames))
    age = longest.frames - longest.frames[0]
    raw = np.isfinite(longest.measured_depth)
    ax.scatter(age[raw], longest.measured_depth[raw], s=9, color=MUTED, alpha=0.8, linewidths=0, zorder=1, label="raw")
    anchors = [longest.measured_depth[raw], longest.true_depth[np.isfinite(longest.true_depth)]]
    labels = []
    if anchors[1].size:
        width = nested_widths(len(traces))[0] + 5
        ax.plot(age, longest.true_depth, color=INK, alpha=0.18, linewidth=width, zorder=0, label="truth")
        labels.append(EndLabel("truth", series.last_known(longest.true_depth), MUTED))
    for (name, trace), width in zip(traces.items(), nested_widths(len(traces)), strict=True):
        x = trace.frames - longest.frames[0]
        low, high = trace.depth - trace.sigma, trace.depth + trace.sigma
        ax.fill_between(x, low, high, color=colours[name], alpha=0.12, linewidth=0, label=f"_{name}")
        ax.plot(x, trace.depth, color=colours[name], linewidth=width, label=name)
        labels.append(EndLabel(name, series.last_known(trace.depth), colours[name]))
    around = np.concatenate([*anchors, *(trace.depth[np.isfinite(trace.depth)] for trace in traces.values())])
    if around.size:
        # A far landmark whose disparity touches zero has a measured depth of kilometres: frame the bulk.
        low, high = np.percentile(around, [3, 97])
        pad = 0.25 * (high - low) + 0.02 * abs(high)
        ax.set_ylim(max(low - pad, 0), high + pad)
        hidden = int((longest.measured_depth[raw] > high + pad).sum())
        if hidden:
            ax.text(0.99, 0.97, f"{hidden} raw above", transform=ax.transAxes, ha="right", va="top", color=MUTED)
    if raw.any():
        labels.append(EndLabel("raw", series.last_known(longest.measured_depth), MUTED))
    label_ends(ax, labels)


def _draw_sigma(ax: Axes, traces: dict[str, LandmarkTrace], colours: dict[str, str]) -> None:
    first = min(int(trace.frames[0]) for trace in traces.values())
    labels = []
    for (name, trace), width in zip(traces.items(), nested_widths(len(traces)), strict=True):
        ax.plot(trace.frames - first, trace.sigma, color=colours[name], linewidth=width, label=name)
        labels.append(EndLabel(name, series.last_known(trace.sigma), colours[name]))
    ax.set_yscale("log")
    plain_log_axis(ax)
    label_ends(ax, labels)


_QUANTITIES = {
    "pose": "pose NEES",
    "position": "position NEES",
    "rotation": "rotation NEES",
    "landmark": "landmark NEES",
    "nis": "NIS",
}


@styled
def plot_consistency(summaries: Sequence[FilterSummary]) -> Figure:
    """Mean NEES and NIS by their degrees of freedom against their bands, and how much of the time they are inside.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        With `consistency`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    colours = filter_colours(s.filter_name for s in summaries)
    rows = [key for key in _QUANTITIES if any(key in s.consistency for s in summaries)]
    figure = Figure(figsize=(WIDTH_INCHES, 1.0 + 0.2 * len(rows) * max(len(summaries), 2)))
    height = figure.get_figheight()
    figure.subplots_adjust(left=0.12, right=0.87, top=1 - 0.36 / height, bottom=0.5 / height, wspace=0.08)
    mean, inside = figure.subplots(1, 2, width_ratios=(2.2, 1), sharey=True)
    step = 0.7 / max(len(summaries), 1)
    _draw_bands(mean, summaries, rows, step)
    peaks: dict[str, float] = {}
    for i, s in enumerate(summaries):
        places = [row - 0.35 + (i + 0.5) * step for row, key in enumerate(rows) if key in s.consistency]
        found = [s.consistency[key] for key in rows if key in s.consistency]
        style = {"s": 30, "color": colours[s.filter_name], "linewidths": 0, "label": s.filter_name}
        means = np.array([figures.mean / figures.dof for figures in found])
        peaks[s.filter_name] = series.peak(means)
        mean.scatter(means, places, **style)
        inside.scatter([figures.inside_percent for figures in found], places, **style)
    limit = shared_limit(peaks, spread=30.0)
    mean.axvline(1, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
    mean.set_xscale("log")
    low, high = mean.get_xlim()
    mean.set_xlim(low, min(high, 1.3 * max(limit.upper, 1.2)))
    plain_log_axis(mean, "x")
    note_beyond(mean, limit, colours)
    mean.set(title="Mean / degrees of freedom, 95 % band in grey", xlabel="1 is ideal; above: overconfident")
    mean.set_yticks(range(len(rows)), [_QUANTITIES[key] for key in rows])
    mean.set_ylim(len(rows) - 0.5, -0.5)
    inside.axvline(95, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
    inside.set(title="Frames inside their band (%)", xlabel="95 if frames were independent (%)", xlim=(-3, 103))
    inside.tick_params(labelleft=False)
    for ax in (mean, inside):
        ax.grid(visible=False, axis="y")
    colour_key(inside, {s.filter_name: colours[s.filter_name] for s in summaries})
    return figure


def _draw_bands(ax: Axes, summaries: Sequence[FilterSummary], rows: Sequence[str], step: float) -> None:
    """One band for the row of a quantity where it is the same for all, else one for each filter."""
    for row, key in enumerate(rows):
        found = [(i, s.consistency[key]) for i, s in enumerate(summaries) if key in s.consistency]
        bands = {(figures.band[0] / figures.dof, figures.band[1] / figures.dof) for _, figures in found}
        if len(bands) == 1:
            ax.fill_betweenx([row - 0.35, row + 0.35], *bands.pop(), color=BAND, linewidth=0, zorder=0)
            continue
        for i, figures in found:
            top = row - 0.35 + i * step
            low, high = (bound / figures.dof for bound in figures.band)
            ax.fill_betweenx([top, top + step], low, high, color=BAND, linewidth=0, zorder=0)
