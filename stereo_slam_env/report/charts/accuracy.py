"""Charts of what a filter achieves: path and errors, distance from the limit; audit of a reference by the images."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, key_of
from stereo_slam_env.evaluation.trial import position_rmse
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.axes import (
    INK,
    MUTED,
    PALETTE,
    WIDTH,
    Axis,
    Limit,
    filter_colours,
    label_room,
    nested_widths,
    panel_width,
    shared_limit,
)
from stereo_slam_env.report.charts.drawing import DASHED, ROW, Chart, Curve, Panel, figure, limit_of

MAX_THIN_LINES = 12
"""Single runs drawn behind a median: more would only darken the picture."""
MAX_DOTS = 100
"""Single runs drawn as dots: the first ones."""
TRUTH: dict[str, Any] = {"width": 7.0, "opacity": 0.18}
"""How the truth is drawn: broad and pale, below the estimates."""


# ---- path and errors ------------------------------------------------------------------------------------------------


def plot_trajectory(runs: Sequence[FilterRun]) -> Chart:
    """Top view of the first recording, and the position error of all runs over the distance."""
    first = series.first_recording(runs)
    colours = filter_colours(run.filter_name for run in runs)
    truth = first[0].true_positions[np.isfinite(first[0].true_positions).all(axis=1)]
    estimates = np.concatenate([run.positions for run in first])
    track = truth if len(truth) else estimates[np.isfinite(estimates).all(axis=1)]
    across, up = series.map_axes(track)
    with_errors = any(np.isfinite(series.position_error(run)).any() for run in runs)
    room = label_room(colours)
    long = not with_errors or bool(np.ptp(track[:, across]) > 3 * np.ptp(track[:, up])) if len(track) else True
    width, height = (WIDTH - 60 - room, 400.0) if long else (400.0, 340.0)
    title = f"Seen from above, {series.reference_name(first[0])} in grey" if len(truth) else "Seen from above"
    view = map_panel(track, (across, up), width, height, title)
    widths = nested_widths(len(first))
    if len(truth):
        name = series.reference_name(first[0])
        broad = {**TRUTH, "width": widths[0] + 6}
        view.lines([Curve("", truth[:, across], truth[:, up], INK, said=name, **broad)])
    view.lines(
        Curve(r.filter_name, r.positions[:, across], r.positions[:, up], colours[r.filter_name], width=w)
        for r, w in zip(first, widths, strict=True)
    )
    if not with_errors:
        view.colour_key({run.filter_name: colours[run.filter_name] for run in first})
        return figure([view], colours)
    wide = WIDTH - 60 - room - (0 if long else view.width + 66)
    errors = _error_over_distance(runs, wide, 240.0 if long else view.height)
    return figure([view, errors], colours, columns=1 if long else 2)


_CAMERA_AXES = ("x, right (m)", "y, down (m)", "z, forward (m)")


def map_panel(
    track: FloatArray,
    axes: tuple[int, int],
    width: float,
    height: float,
    title: str,
    names: Sequence[str] = _CAMERA_AXES,
) -> Panel:
    """A panel around a track (N, 3), with equal scales; seen from above, x points down where z runs across."""
    across, up = axes
    ends = np.stack([track.min(axis=0), track.max(axis=0)]) if len(track) else np.zeros((2, 3))
    margin = 0.06 * float(np.ptp(ends[:, [across, up]], axis=0).max()) + 0.5
    low, high = ends[0] - margin, ends[1] + margin
    extent = high - low
    scale = min(width / extent[across], height / extent[up])
    size = scale * extent[across], max(scale * extent[up], 70.0)
    if scale * extent[up] < 70.0:  # a straight drive: the scales stay equal, the field is higher than the path
        more = 0.5 * (70.0 / scale - extent[up])
        low[up], high[up] = low[up] - more, high[up] + more
    x, y = (float(low[across]), float(high[across])), (float(low[up]), float(high[up]))
    return Panel(Axis(*x, names[across]), Axis(*y, names[up], reverse=across == 2), *size, title)


def _error_over_distance(runs: Sequence[FilterRun], width: float, height: float) -> Panel:
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    errors = {name: series.stack(group, series.position_error) for name, group in groups.items()}
    medians = [
        Curve(name, series.column_mean(series.stack(group, series.distance)), median, colours[name], width=2.2)
        for name, group in groups.items()
        for median in [series.column_median(errors[name])]
    ]
    # Nine runs out of ten fit: a single bad run is told in the table, not by flattening the rest.
    peaks = {name: np.array([series.peak(row) for row in table]) for name, table in errors.items()}
    most = {
        name: float(np.nanquantile(peak, 0.9, method="lower")) if np.isfinite(peak).any() else np.nan
        for name, peak in peaks.items()
    }
    limit = shared_limit({c.key: float(np.fmax(most[c.key], series.peak(c.y))) for c in medians}, spread=30.0)
    farthest = max((series.peak(curve.x) for curve in medians), default=1.0)
    count = max(len(group) for group in groups.values())
    title = f"Position error (m), median of {count}" if count > 1 else "Position error (m)"
    panel = Panel(Axis(0, farthest, "distance travelled (m)"), Axis(0, 1.08 * limit.upper), width, height, title)
    for curve in medians:
        thin = errors[curve.key][:MAX_THIN_LINES] if len(errors[curve.key]) > 1 else ()
        panel.lines(dataclasses.replace(curve, y=single, width=0.8, opacity=0.25, said=None) for single in thin)
        panel.lines([curve])
    panel.name_ends(medians, limit)
    panel.note_beyond(limit, colours, " m")
    return panel


def plot_error_by_run(runs: Sequence[FilterRun]) -> Chart:
    """Position RMSE of each run, and below it by that of the best filter on the same recording: a paired comparison."""
    groups = series.by_filter(runs)
    names, colours = list(groups), filter_colours(groups)
    failed = {name: sum(run.failure is not None for run in group) for name, group in groups.items()}
    notes = {name: f"({count} failed)" for name, count in failed.items() if count}
    rmse = {(run.filter_name, *key_of(run)): position_rmse(run) for run in runs}

    def dotted(title: str, rows: Sequence[str], values: Mapping[tuple[str, str, int | None], float]) -> Panel:
        ends = [*values.values(), *([] if values is rmse else [1.0])]
        panel = _rows(title, rows, ends, spread=10.0 if values is rmse else 1.0, colours=colours, notes=notes)
        panel.dots(
            (
                Curve(name, [value], [rows.index(name)], colours[name], opacity=0.85, said=_said(name, recording, seed))
                for (name, recording, seed), value in values.items()
            ),
            size=48,
        )
        return panel

    panels = [dotted("position RMSE of each run (m)", names, rmse)]
    squares = {name: [value**2 for key, value in rmse.items() if key[0] == name] for name in names}
    best = min(names, key=lambda name: float(np.mean(squares[name])) if np.isfinite(squares[name]).all() else np.inf)
    rivals = [name for name in names if name != best]
    ratios = {key: value / rmse.get((best, *key[1:]), np.nan) for key, value in rmse.items() if key[0] != best}
    if np.isfinite(list(ratios.values())).any():
        panels.append(dotted(f"RMSE by that of {best} on the same recording", rivals, ratios))
        panels[-1].rule(x=1.0, dash=DASHED)
    return figure(panels, colours, columns=1, row=44)


def plot_velocity(runs: Sequence[FilterRun]) -> Chart:
    """Velocity in W and heading on the first recording, as in the paper's Fig. 6."""
    first = series.first_recording(runs)
    colours = filter_colours(run.filter_name for run in first)
    truth = series.reference_name(first[0])
    has_truth = np.isfinite(first[0].true_positions).any()
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
    time = series.elapsed(first[0])
    width = panel_width(1, label_room([*colours, truth]))
    panels = []
    for title, unit, estimate, true in rows:
        values = {run.filter_name: estimate(run) for run in first}
        y, limit = _around(true(first[0]), values)
        panel = Panel(Axis(0, float(time[-1]), "time (s)" if title == rows[-1][0] else ""), y, width, 120.0, title)
        if np.isfinite(true(first[0])).any():
            panel.lines([Curve("", time, true(first[0]), INK, said=truth, **TRUTH)])
        panel.lines(
            Curve(r.filter_name, series.elapsed(r), values[r.filter_name], colours[r.filter_name], width=1.3)
            for r in first
        )
        panel.note_beyond(limit, colours, f" {unit}")
        panels.append(panel)
    panels[0].colour_key(({truth: MUTED} if has_truth else {}) | colours)
    return figure(panels, colours, columns=1, row=52)


def _around(truth: FloatArray, estimates: Mapping[str, FloatArray]) -> tuple[Axis, Limit]:
    """An axis that the truth sets, or else the estimates, and which estimates leave it for over 2 % of the time."""
    everything = truth if np.isfinite(truth).any() else np.concatenate(list(estimates.values()))
    finite = everything[np.isfinite(everything)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    margin = 0.15 * (high - low) + 0.5
    beyond = {}
    for name, values in estimates.items():
        known = values[np.isfinite(values)]
        outside = (known < low - margin) | (known > high + margin)
        if known.size and outside.mean() > 0.02:
            beyond[name] = series.peak(known)
    return Axis(low - margin, high + margin), Limit(high, beyond)


def _true_v(axis: int) -> series.Quantity:
    return lambda run: run.true_linear_velocities[:, axis]


def plot_segment_errors(summaries: Sequence[FilterSummary]) -> Chart:
    """Relative errors over segments of the path, by their length, as KITTI measures them."""
    with_segments = [s for s in summaries if s.rpe]
    colours = filter_colours(s.filter_name for s in summaries)
    lengths = sorted({error.length_m for s in with_segments for error in s.rpe})
    beside = 0.04 * (lengths[-1] - lengths[0]) + 0.5
    ticks = lengths[:: -(-len(lengths) // 8)]  # of many, each second, third ...
    x = Axis(lengths[0] - beside, lengths[-1] + beside, "length of the segment (m)", ticks=ticks)
    kinds = {
        "Translation error over a segment (%)": "translation_percent",
        "Rotation error over a segment (°/100 m)": "rotation_deg_per_100m",
    }
    panels = []
    for title, name in kinds.items():
        curves = [
            Curve(s.filter_name, [e.length_m for e in s.rpe], [getattr(e, name) for e in s.rpe], colours[s.filter_name])
            for s in with_segments
        ]
        limit = limit_of(curves)
        panel = Panel(x, Axis(0, 1.12 * limit.upper), panel_width(2, label_room(colours)), 200.0, title)
        panel.lines(curves)
        panel.dots(curves)
        panel.note_beyond(limit, colours)
        panels.append(panel)
    panels[-1].name_ends(curves, limit)
    return figure(panels, colours)


# ---- distance from the limit ----------------------------------------------------------------------------------------


def plot_efficiency(summaries: Sequence[FilterSummary]) -> Chart:
    """Bound / RMSE of each run: 100 % leaves nothing to gain on average."""
    rated = [s for s in summaries if s.efficiency_percent is not None]
    names = [s.filter_name for s in rated]
    colours = filter_colours(s.filter_name for s in summaries)
    by_run = {s.filter_name: s.efficiency_by_run[:MAX_DOTS] for s in rated}
    everything = [100.0, *(value for s in rated for value in (*by_run[s.filter_name], s.efficiency_percent or np.nan))]
    panel = _rows("bound / position RMSE of each run (%)", names, everything, spread=30.0, colours=colours)
    panel.rule(x=100.0, dash=DASHED)
    panel.dots(
        (
            Curve(
                s.filter_name,
                by_run[s.filter_name],
                [row] * len(by_run[s.filter_name]),
                colours[s.filter_name],
                opacity=0.55,
            )
            for row, s in enumerate(rated)
        ),
        size=44,
    )
    panel.lines(
        Curve(s.filter_name, [share, share], [row - 0.3, row + 0.3], INK, width=2.2, said=f"{s.filter_name}, all runs")
        for row, s in enumerate(rated)
        if (share := s.efficiency_percent) is not None
    )
    return figure([panel], {name: colours[name] for name in names})


def plot_error_against_bound(runs: Sequence[FilterRun], bounds: Bounds) -> Chart:
    """Root mean square error over runs, frame by frame, above the posterior Cramer-Rao bound.

    Raises ValueError where no run has a bound.
    """
    bounded = [run for run in runs if key_of(run) in bounds]
    if not bounded:
        raise ValueError("bounds must have the recording of at least one of the runs")
    groups = series.by_filter(bounded)
    colours = filter_colours(series.by_filter(runs))
    frames = max(len(run) for run in bounded)
    time = series.elapsed(max(bounded, key=len))
    on_each = {key_of(run): run for run in bounded}.values()
    panels = []
    for title, part, scale in (
        ("Position RMSE over runs (m)", slice(0, 3), 1.0),
        ("Rotation RMSE over runs (°)", slice(3, 6), 180 / np.pi),
    ):

        def rms(group: Iterable[FilterRun], squared: series.Quantity, scale: float = scale) -> FloatArray:
            return np.asarray(scale * np.sqrt(series.column_mean(series.stack([*group], squared, frames))))

        def squared_error(run: FilterRun, part: slice = part) -> FloatArray:
            return np.asarray((series.belief_error(run)[0][:, part] ** 2).sum(axis=1))

        def squared_bound(run: FilterRun, part: slice = part) -> FloatArray:
            return np.asarray(np.trace(bounds[key_of(run)].pose[:, part, part], axis1=1, axis2=2))

        curves = [Curve(name, time, rms(group, squared_error), colours[name]) for name, group in groups.items()]
        lowest = Curve("limit", time, rms(on_each, squared_bound), INK, width=2.0)
        limit = limit_of(curves, spread=20.0)
        y = Axis(0, 1.1 * max(limit.upper, series.peak(lowest.y)))
        width = panel_width(2, label_room([*groups, "limit"]))
        panel = Panel(Axis(0, float(time[-1]), "time (s)"), y, width, 220.0, title)
        panel.lines(curves)
        panel.lines([lowest], DASHED)
        panel.note_beyond(limit, colours)
        panels.append(panel)
    panels[-1].name_ends([*curves, lowest], limit)
    return figure(panels, {name: colours[name] for name in groups} | {"limit": INK})


# ---- a row for each filter ------------------------------------------------------------------------------------------


def _rows(
    title: str,
    names: Sequence[str],
    values: Iterable[float],
    *,
    spread: float,
    colours: Mapping[str, str] | None = None,
    notes: Mapping[str, str] | None = None,
) -> Panel:
    """A panel with a row for each name; its axis is logarithmic where values are more than `spread` times apart."""
    left = label_room(f"{name} {(notes or {}).get(name, '')}" for name in names)
    finite = np.array([value for value in values if np.isfinite(value) and value > 0])
    log = bool(finite.size and finite.max() > spread * finite.min())
    low, high = (finite.min() / 1.25, finite.max() * 1.25) if log else (0.0, 1.06 * finite.max(initial=1e-9))
    y = Axis.of_rows(len(names))
    panel = Panel(Axis(float(low), float(high), title, log=log), y, WIDTH - left - 40, ROW * len(names))
    panel.row_names(names, colours or filter_colours(names), notes)
    return panel


def _said(name: str, recording: str, seed: int | None) -> str:
    return f"{name}, {recording}" + (f", seed {seed}" if seed is not None else "")


DOUBTFUL = "reference doubtful here"
_LEAST = 0.02
"""Lower end of the axis, px: below it nothing is to be told."""


def plot_audit(audit: ReferenceAudit) -> Chart:
    """Median residual of tracks by each step of the reference, and by the images; doubtful steps have a dot."""
    floor = np.maximum([audit.by_reference, audit.by_images], _LEAST)
    lines = [
        Curve("by the images", audit.frames, floor[1], MUTED, width=1.2),
        Curve("by the reference", audit.frames, floor[0], INK, width=1.2),
    ]
    dots = Curve(DOUBTFUL, audit.frames[audit.doubtful], floor[0][audit.doubtful], PALETTE[1])
    colours = {curve.key: curve.colour for curve in (*lines, dots)}
    limit = limit_of(lines, spread=1e3)
    y = Axis(0.8 * float(floor.min()), 1.5 * limit.upper, log=True)
    x = Axis(float(audit.frames[0]) - 1.0, float(audit.frames[-1]) + 1.0, "frame")
    panel = Panel(x, y, panel_width(1, label_room(colours)), 220.0, "Median distance of tracks, left image (px)")
    panel.lines(lines)
    panel.dots([dots])
    panel.colour_key(colours)
    return figure([panel], colours)
