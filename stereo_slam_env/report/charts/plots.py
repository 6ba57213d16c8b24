"""Figures of where the filters went, how well, and at what cost. Each function is pure: runs in, Figure out.

Consistency figures (3-sigma bounds, NEES, NIS, depth) are in `consistency`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from filters.validation import FloatArray
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.trial import position_rmse
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.style import (
    INK,
    MUTED,
    WIDTH_INCHES,
    EndLabel,
    Limit,
    colour_key,
    filter_colours,
    label_ends,
    name_rows,
    nested_widths,
    note_beyond,
    plain_log_axis,
    shared_limit,
    styled,
)

MAX_THIN_LINES = 12
"""Single runs drawn behind a median: more would only darken the picture."""


@styled
def plot_trajectory(runs: Sequence[FilterRun]) -> Figure:
    """Top view of the first recording, and the position error of all runs over the distance.

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs of any number of filters and recordings.

    Returns
    -------
    matplotlib.figure.Figure
        One panel where there is no truth, else two.
    """
    shown = series.first_recording(runs)
    colours = filter_colours(run.filter_name for run in runs)
    reference = _reference_track(shown)
    across, up = orientation(reference)
    with_errors = any(np.isfinite(series.position_error(run)).any() for run in runs)
    figure, top_view, errors = _trajectory_axes(reference[:, [across, up]], with_errors)

    truth = shown[0].true_positions
    known = np.isfinite(truth).all(axis=1)
    if known.any():
        width = nested_widths(len(shown))[0] + 5
        top_view.plot(truth[known, across], truth[known, up], color=INK, alpha=0.18, linewidth=width, label="_truth")
    for run, width in zip(shown, nested_widths(len(shown)), strict=True):
        x, y = run.positions[:, across], run.positions[:, up]
        top_view.plot(x, y, color=colours[run.filter_name], linewidth=width, label=run.filter_name)
    frame_track(top_view, reference, across, up)
    axis_names = {0: "x, right (m)", 2: "z, forward (m)"}
    title = f"Seen from above, {series.reference_name(shown[0])} in grey" if known.any() else "Seen from above"
    top_view.set(xlabel=axis_names[across], ylabel=axis_names[up], title=title)
    if errors is None:
        colour_key(top_view, {run.filter_name: colours[run.filter_name] for run in shown})
    else:
        _draw_error_over_distance(errors, runs)
    return figure


@styled
def plot_error_by_run(runs: Sequence[FilterRun]) -> Figure:
    """Position RMSE of each run, runs on the same recording joined: the paired comparison to look at first.

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs of several filters on several recordings.

    Returns
    -------
    matplotlib.figure.Figure
    """
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    names = list(groups)
    failed = {name: sum(run.failure is not None for run in groups[name]) for name in names}
    notes = {name: f"({count} failed)" for name, count in failed.items() if count}
    rmse = {(run.filter_name, run.recording_name, run.seed): position_rmse(run) for run in runs}
    figure = Figure(figsize=(WIDTH_INCHES, 0.9 + 0.42 * len(names)))
    ax = figure.add_axes((0.15, 0.5 / figure.get_figheight(), 0.82, 1 - 0.6 / figure.get_figheight()))
    for recording in dict.fromkeys((run.recording_name, run.seed) for run in runs):
        joined = [rmse.get((name, *recording), np.nan) for name in names]
        ax.plot(joined, range(len(names)), color=MUTED, alpha=0.35, linewidth=0.8, zorder=1)
    for row, name in enumerate(names):
        values = [value for (owner, *_), value in rmse.items() if owner == name]
        ax.scatter(
            values, [row] * len(values), s=26, color=colours[name], alpha=0.85, linewidths=0, zorder=2, label=name
        )
    finite = np.array([value for value in rmse.values() if np.isfinite(value) and value > 0])
    if finite.size and finite.max() > 10 * finite.min():
        ax.set_xscale("log")
        plain_log_axis(ax, "x")
    else:
        ax.set_xlim(left=0)
    ax.set(xlabel="position RMSE of each run (m)", ylim=(len(names) - 0.5, -0.5))
    name_rows(ax, names, colours, notes)
    return figure


@styled
def plot_velocity(runs: Sequence[FilterRun]) -> Figure:
    """Velocity in W and heading on the first recording, as in the paper's Fig. 6.

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs of any number of filters and recordings.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels: Vx, Vz, yaw.
    """
    shown = series.first_recording(runs)
    rows: tuple[tuple[str, str, series.Quantity, series.Quantity], ...] = (
        ("Velocity to the right, Vx (m/s)", "m/s", lambda r: r.linear_velocities[:, 0], _true_v(0)),
        ("Velocity forward, Vz (m/s)", "m/s", lambda r: r.linear_velocities[:, 2], _true_v(2)),
        (
            "Heading, yaw (°)",
            "°",
            lambda r: np.rad2deg(series.heading(r.orientations)),
            lambda r: np.rad2deg(series.heading(r.true_orientations)),
        ),
    )
    figure = Figure(figsize=(WIDTH_INCHES, 5.6))
    figure.subplots_adjust(left=0.07, right=0.87, top=0.95, bottom=0.085, hspace=0.38)
    panels = figure.subplots(3, 1, sharex=True)
    for ax, (title, unit, estimate, true) in zip(panels, rows, strict=True):
        ax.set_title(title)
        _draw_over_time(ax, shown, estimate, true, unit)
    panels[-1].set_xlabel("time (s)")
    colours = filter_colours(run.filter_name for run in shown)
    key = {series.reference_name(shown[0]): MUTED} if np.isfinite(shown[0].true_positions).any() else {}
    colour_key(panels[0], key | {run.filter_name: colours[run.filter_name] for run in shown})
    return figure


@styled
def plot_time_per_frame(runs: Sequence[FilterRun]) -> Figure:
    """Predict + update: median over runs along the drive, and against the size of the map.

    Parameters
    ----------
    runs : sequence of FilterRun
        Runs of any number of filters and recordings.

    Returns
    -------
    matplotlib.figure.Figure
    """
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    figure = Figure(figsize=(WIDTH_INCHES, 3.1))
    figure.subplots_adjust(left=0.06, right=0.87, top=0.9, bottom=0.16, wspace=0.18)
    over_time, over_size = figure.subplots(1, 2, sharey=True)
    labels, top = [], {}
    for name, group in groups.items():
        times = series.column_median(series.stack(group, lambda run: run.milliseconds))
        over_time.plot(series.elapsed(max(group, key=len)), times, color=colours[name], linewidth=1, label=name)
        sizes, typical = _by_map_size(group)
        over_size.plot(sizes, typical, color=colours[name], marker="o", markersize=3.2, label=name)
        labels.append(EndLabel(name, series.last_known(typical), colours[name]))
        # One slow frame (a garbage collection, a busy machine) must not set the scale.
        top[name] = float(np.nanpercentile(times, 99)) if np.isfinite(times).any() else np.nan
    limit = shared_limit(top)
    over_time.set(title="Time per frame (ms)", xlabel="time (s)", ylim=(0, 1.2 * limit.upper))
    over_size.set(title="Time per frame (ms) by size of the map", xlabel="landmarks in the map")
    over_time.set_xlim(left=0)
    note_beyond(over_time, limit, colours, " ms")
    label_ends(over_size, labels)
    return figure


def _reference_track(runs: Sequence[FilterRun]) -> FloatArray:
    """Return what the top view must show whole: the truth, or else every estimate."""
    truth = runs[0].true_positions
    known = np.isfinite(truth).all(axis=1)
    track = truth[known] if known.any() else np.concatenate([run.positions for run in runs])
    return np.asarray(track[np.isfinite(track).all(axis=1)], dtype=np.float64)


def orientation(track: FloatArray) -> tuple[int, int]:
    """Return the axes to draw across and up: long drives lie on their side."""
    if not len(track):
        return 0, 2
    extent_x, _, extent_z = np.ptp(track, axis=0)
    return (2, 0) if extent_z > extent_x else (0, 2)


def _trajectory_axes(track: FloatArray, with_errors: bool) -> tuple[Figure, Axes, Axes | None]:
    """Lay out the top view and the errors: side by side, or one below the other for a long, thin drive."""
    across, up = np.ptp(track, axis=0) + 1.0 if len(track) else (1.0, 1.0)
    if not with_errors:
        figure = Figure(figsize=(WIDTH_INCHES, 4.6))
        return figure, figure.add_axes((0.07, 0.12, 0.8, 0.8)), None
    if across < 3 * up:
        figure = Figure(figsize=(WIDTH_INCHES, 3.9))
        return figure, figure.add_axes((0.06, 0.12, 0.36, 0.8)), figure.add_axes((0.48, 0.12, 0.39, 0.8))
    thin = max(0.8 * WIDTH_INCHES * up / across, 0.7)
    height = thin + 3.9
    figure = Figure(figsize=(WIDTH_INCHES, height))
    top_view = figure.add_axes((0.07, 1 - (thin + 0.35) / height, 0.8, thin / height))
    return figure, top_view, figure.add_axes((0.07, 0.5 / height, 0.8, 2.3 / height))


def frame_track(ax: Axes, track: FloatArray, across: int, up: int) -> None:
    """Limits around the track, equal scales; x points down when z runs across (the view is from above)."""
    ax.set_aspect("equal", adjustable="box", anchor="NW")
    if len(track):
        margin = 0.06 * float(np.ptp(track[:, [across, up]], axis=0).max()) + 0.5
        low, high = track.min(axis=0) - margin, track.max(axis=0) + margin
        ax.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]))
    if across == 2:
        ax.invert_yaxis()


def _draw_error_over_distance(ax: Axes, runs: Sequence[FilterRun]) -> None:
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    curves, peaks = {}, {}
    for name, group in groups.items():
        errors = series.stack(group, series.position_error)
        distances = series.column_mean(series.stack(group, series.distance))
        curves[name] = (distances, errors, series.column_median(errors))
        # Nine runs out of ten fit: a single bad run is told in the table, not by flattening the rest.
        peaks[name] = float(np.nanquantile([series.peak(row) for row in errors], 0.9, method="lower"))
    limit = shared_limit(peaks, spread=30.0)
    labels = []
    for name, (distances, errors, median) in curves.items():
        for single in errors[:MAX_THIN_LINES] if len(errors) > 1 else ():
            shown = np.isfinite(single) & np.isfinite(distances)
            x, y = distances[shown], single[shown]
            ax.plot(x, y, color=colours[name], alpha=0.2, linewidth=0.7, label=f"_{name}")
        shown = np.isfinite(median) & np.isfinite(distances)
        ax.plot(distances[shown], median[shown], color=colours[name], linewidth=1.8, label=name)
        labels.append(EndLabel(name, series.last_known(median), colours[name]))
    count = max(len(group) for group in groups.values())
    ax.set_title(f"Position error (m), median of {count}" if count > 1 else "Position error (m)")
    ax.set(xlabel="distance travelled (m)", xlim=(0, None), ylim=(0, 1.08 * limit.upper))
    note_beyond(ax, limit, colours, " m")
    label_ends(ax, [label for label in labels if label.text not in limit.beyond])


def _draw_over_time(
    ax: Axes,
    runs: Sequence[FilterRun],
    estimate: series.Quantity,
    true: series.Quantity,
    unit: str,
) -> None:
    """Estimates of all filters over the truth, with the truth (or the estimates) setting the scale."""
    colours = filter_colours(run.filter_name for run in runs)
    time, truth = series.elapsed(runs[0]), true(runs[0])
    known = np.isfinite(truth)
    if known.any():
        name = series.reference_name(runs[0])
        ax.plot(time[known], truth[known], color=INK, alpha=0.18, linewidth=5, label=name)
    for run in runs:
        colour, name = colours[run.filter_name], run.filter_name
        ax.plot(series.elapsed(run), estimate(run), color=colour, linewidth=1, alpha=0.85, label=name)
    if known.any():
        low, high = float(truth[known].min()), float(truth[known].max())
        margin = 0.15 * (high - low) + 0.5
        ax.set_ylim(low - margin, high + margin)
        limit = Limit(high, {run.filter_name: p for run in runs if (p := _excess(estimate(run), low, high, margin))})
        note_beyond(ax, limit, colours, f" {unit}")
    ax.set_xlim(0, time[-1])


def _excess(values: FloatArray, low: float, high: float, margin: float) -> float:
    """Largest absolute value if the curve is out of the frame for more than 2 % of the time, else 0."""
    finite = values[np.isfinite(values)]
    outside = (finite < low - margin) | (finite > high + margin)
    return series.peak(finite) if finite.size and outside.mean() > 0.02 else 0.0


def _true_v(axis: int) -> series.Quantity:
    return lambda run: run.true_linear_velocities[:, axis]


def _by_map_size(runs: Sequence[FilterRun], bins: int = 8) -> tuple[FloatArray, FloatArray]:
    """Median milliseconds in bins of the map size with equally many frames; both (B,)."""
    sizes = np.concatenate([run.counts["map_size"] for run in runs]).astype(np.float64)
    times = np.concatenate([run.milliseconds for run in runs])
    known = np.isfinite(times) & (sizes > 0)
    if not known.any():
        return np.zeros(0), np.zeros(0)
    edges = np.unique(np.quantile(sizes[known], np.linspace(0, 1, bins + 1)))
    which = np.clip(np.searchsorted(edges, sizes[known], side="right"), 1, max(len(edges) - 1, 1))
    filled = np.unique(which)
    return (
        np.array([np.median(sizes[known][which == b]) for b in filled]),
        np.array([np.median(times[known][which == b]) for b in filled]),
    )
