"""Charts of consistency: errors against 3-sigma bounds, NEES, NIS, depth and map."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.bands import DOF, mean_bands
from stereo_slam_env.evaluation.landmark_statistics import DepthConvergence, RangeError
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.axes import (
    BAND,
    INK,
    MUTED,
    WIDTH,
    Axis,
    filter_colours,
    label_room,
    log_axis,
    nested_widths,
    panel_width,
    shared_limit,
    short_number,
)
from stereo_slam_env.report.charts.drawing import DASHED, BoxMark, Chart, Curve, Panel, ends_of, figure, limit_of

# The order of the panels; columns of the pose error. The camera frame is x right, y down, z forward: roll is about z.
_PANELS = (
    ("x", 0, "cm", 100.0),
    ("y", 1, "cm", 100.0),
    ("z", 2, "cm", 100.0),
    ("roll", 5, "°", 180.0 / np.pi),
    ("pitch", 3, "°", 180.0 / np.pi),
    ("yaw", 4, "°", 180.0 / np.pi),
)
_QUANTITIES = {
    "pose": "pose NEES",
    "position": "position NEES",
    "rotation": "rotation NEES",
    "landmark": "landmark NEES",
    "nis": "NIS",
}

# ---- along the drive ------------------------------------------------------------------------------------------------


def error_limits(runs: Sequence[FilterRun]) -> FloatArray:
    """Half heights (6,) that let the error charts of several filters be compared; m and rad.

    A diverged filter does not count: the others stay readable; nor does one that ended at its start.
    """
    ran = [run for run in runs if len(run.timestamps) > 1]
    return shared_error_limits({run.filter_name: series.belief_error(run) for run in ran})


def shared_error_limits(errors: Mapping[str, tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Half heights (6,) for pose errors (K, 6) and their standard deviations (K, 6), m and rad."""
    reach = {name: np.stack([np.abs(error), 3 * sigma]) for name, (error, sigma) in errors.items()}
    peaks = [{name: series.peak(both[:, :, axis]) for name, both in reach.items()} for axis in range(6)]
    return np.array([shared_limit(of_axis).upper for of_axis in peaks])


def plot_error_bounds(run: FilterRun, limits: FloatArray | None = None) -> Chart:
    """Pose error inside its claimed 3-sigma bounds, one panel per degree of freedom."""
    limits = error_limits([run]) if limits is None else limits
    return pose_error_chart(run.filter_name, series.elapsed(run), *series.belief_error(run), limits)


def pose_error_chart(name: str, time: FloatArray, error: FloatArray, sigma: FloatArray, limits: FloatArray) -> Chart:
    """Pose errors (K, 6), position first, inside 3 standard deviations (K, 6), NaN where nothing is claimed."""
    colour = filter_colours([name])[name]
    panels = []
    for number, (title, axis, unit, scale) in enumerate(_PANELS):
        e, bound = scale * error[:, axis], 3 * scale * sigma[:, axis]
        half = 1.12 * float(scale * limits[axis])
        x = Axis(0, float(time[-1]), "time (s)" if number >= 3 else "")
        panel = Panel(x, Axis(-half, half), panel_width(3, 10.0, 52.0), 140.0, f"{title} ({unit})")
        panel.bands([Curve("", time, e, colour, -bound, bound, opacity=0.13)])
        side = {"width": 0.9, "opacity": 0.45}
        panel.lines(Curve("", time, end, colour, said=label, **side) for end, label in ((bound, "3σ"), (-bound, "3σ")))
        panel.lines([Curve("", time, e, colour, width=1.4, said="error")])
        inside = np.isfinite(e) & np.isfinite(bound) & (bound > 0)
        share = f"{100 * np.mean(np.abs(e[inside]) <= bound[inside]):.0f} % inside ±3σ" if inside.any() else ""
        panel.note((f"max {short_number(series.peak(e))} {unit}, " if series.peak(e) > half else "") + share)
        if number == 0:
            panel.text(name, 0, -34, colour, bold=True, size=13.5)
        panels.append(panel)
    return figure(panels, columns=3, column=52, row=48)


def plot_nees(runs: Sequence[FilterRun]) -> Chart:
    """NEES / 6 of the pose, averaged over runs, with its two-sided 95 % chi-square band."""
    tables = {
        name: series.stack(group, lambda run: run.pose_nees / DOF["pose"])
        for name, group in series.by_filter(runs).items()
    }
    curves = {name: series.column_mean(table) for name, table in tables.items()}
    most = max(tables.values(), key=lambda table: int(np.isfinite(table).sum()))
    count = np.isfinite(most).sum(axis=0)
    low, high = (end / DOF["pose"] for end in mean_bands(DOF["pose"], np.where(count > 0, count, np.nan)))
    runs_shown = int(count.max(initial=0))
    of_runs = f", mean of {runs_shown} runs" if runs_shown > 1 else ""
    title = f"Pose NEES / 6{of_runs} (1 is ideal)"
    return band_chart(title, series.elapsed(max(runs, key=len)), curves, (low, high))


def plot_nis(runs: Sequence[FilterRun], points: int = 80) -> Chart:
    """NIS per degree of freedom with its two-sided 95 % band, pooled over runs and short stretches of time.

    A consistent filter's innovations are white, so frames may be pooled (those of NEES may not): as many in each
    stretch, or the band would be a sawtooth. What is left at the end is too short for one, and left out.
    """
    time = series.elapsed(max(runs, key=len))
    first = min(1, len(time) - 1)  # the first frame has no innovations
    together = max(1, -(-(len(time) - first) // points))
    starts = np.arange(first, len(time) - together + 1, together)
    span = slice(first, first + len(starts) * together)
    curves: dict[str, FloatArray] = {}
    dofs: list[FloatArray] = []
    for name, group in series.by_filter(runs).items():
        nis = series.stack(group, lambda run: run.nis, frames=len(time))
        dof = series.stack(group, lambda run: run.nis_dof.astype(np.float64), frames=len(time))
        dof[~np.isfinite(nis)] = 0.0
        sums, pooled = (
            np.nansum(values, axis=0)[span].reshape(len(starts), together).sum(axis=1) for values in (nis, dof)
        )
        curves[name] = np.divide(sums, pooled, out=np.full(len(starts), np.nan), where=pooled > 0)
        dofs.append(pooled)
    fewest = np.min(dofs, axis=0)
    band = mean_bands(1, np.where(fewest > 0, fewest, np.nan))
    return band_chart("NIS per degree of freedom (1 is ideal)", time[starts], curves, band)


def band_chart(
    title: str, time: FloatArray, curves: Mapping[str, FloatArray], band: tuple[FloatArray, FloatArray]
) -> Chart:
    """Curves, of which 1 is ideal, on a log axis (twice too large and too small look alike) over the band."""
    low, high = band
    colours = filter_colours(curves)
    finite = np.isfinite(low)
    lines = [
        Curve(name, time, np.where(curve > 0, curve, np.nan), colours[name], width=1.4)
        for name, curve in curves.items()
    ]
    limit = limit_of(lines, spread=100.0)
    floor = min((float(np.percentile(c[c > 0], 1)) for c in curves.values() if (c > 0).any()), default=0.1)
    bottom = max(min(floor, float(low[finite].min(initial=np.inf))), 0.02)
    top = max(limit.upper, float(high[finite].max(initial=0.0)), 1.01 * bottom)
    margin = (top / bottom) ** 0.06
    y = Axis(bottom / margin, top * margin, log=True)
    width = panel_width(1, label_room([*curves, "95 % band"]))
    panel = Panel(Axis(0, float(time[-1]), "time (s)"), y, width, 250.0, title)
    # What goes below 0.02 is drawn at the lower end: 0 has no place on a logarithmic axis.
    panel.bands([Curve("", time, low, BAND, np.maximum(low, y.low), high)])
    panel.rule(y=1.0, dash=DASHED)
    panel.lines(lines)
    panel.note_beyond(limit, colours)
    centre = float(np.sqrt(low[finite][-1] * high[finite][-1])) if finite.any() else np.nan
    panel.name_ends([*lines, Curve("95 % band", time[-1:], [centre], MUTED)], limit)
    return figure([panel], colours)


# ---- all figures ----------------------------------------------------------------------------------------------------


def plot_consistency(summaries: Sequence[FilterSummary]) -> Chart:
    """Mean NEES and NIS by their degrees of freedom against their bands, and how much of the time they are inside."""
    colours = filter_colours(s.filter_name for s in summaries)
    keys = [key for key in _QUANTITIES if any(key in s.consistency for s in summaries)]
    step = 0.7 / max(len(summaries), 1)
    means, inside, peaks = [], [], {}
    for i, s in enumerate(summaries):
        found = [s.consistency[key] for key in keys if key in s.consistency]
        places = [row - 0.35 + (i + 0.5) * step for row, key in enumerate(keys) if key in s.consistency]
        values = np.array([figures.mean / figures.dof for figures in found])
        peaks[s.filter_name] = series.peak(values)
        means.append(Curve(s.filter_name, values, places, colours[s.filter_name]))
        shares = [figures.inside_percent for figures in found]
        inside.append(Curve(s.filter_name, shares, places, colours[s.filter_name]))
    boxes = _row_bands(summaries, keys, step)
    limit = shared_limit(peaks, spread=30.0)
    extent = [v for c in means for v in np.atleast_1d(np.asarray(c.x)) if np.isfinite(v) and v > 0]
    low = 0.85 * min([*extent, *(box.x0 for box in boxes if box.x0 > 0), 1.0])
    high = 1.3 * max(limit.upper, *(box.x1 for box in boxes), 1.2) if boxes else 1.3 * max(limit.upper, 1.2)
    left, right = label_room(_QUANTITIES.values()), label_room(colours)
    share = (WIDTH - left - right - 70) / 3.2
    y = Axis.of_rows(len(keys))
    height = max(len(keys) * max(len(summaries), 2) * 14.0, 70.0)
    x = Axis(low, high, "1 is ideal; above: overconfident", log=True)
    mean = Panel(x, y, 2.2 * share, height, "Mean / degrees of freedom, 95 % band in grey")
    mean.boxes(boxes)
    mean.rule(x=1.0, dash=DASHED)
    mean.dots(means, 46)
    mean.row_names([_QUANTITIES[key] for key in keys], {})
    mean.note_beyond(limit, colours)
    x = Axis(-3, 103, "95 if frames were independent (%)", ticks=(0, 20, 40, 60, 80, 100))
    frames = Panel(x, y, share, height, "Frames inside their band (%)")
    frames.rule(x=95.0, dash=DASHED)
    frames.dots(inside, 46)
    frames.colour_key({s.filter_name: colours[s.filter_name] for s in summaries})
    return figure([mean, frames], colours, column=36)


def _row_bands(summaries: Sequence[FilterSummary], keys: Sequence[str], step: float) -> list[BoxMark]:
    """One band for the row of a quantity where it is the same for all, else one for each filter."""
    boxes = []
    for row, key in enumerate(keys):
        found = [(i, s.consistency[key]) for i, s in enumerate(summaries) if key in s.consistency]
        bands = {(figures.band[0] / figures.dof, figures.band[1] / figures.dof) for _, figures in found}
        if len(bands) == 1:
            boxes.append(BoxMark(*bands.pop(), row - 0.35, row + 0.35, BAND))
            continue
        for i, figures in found:
            top = row - 0.35 + i * step
            boxes.append(BoxMark(figures.band[0] / figures.dof, figures.band[1] / figures.dof, top, top + step, BAND))
    return boxes


# ---- the map --------------------------------------------------------------------------------------------------------


def plot_depth(runs: Sequence[FilterRun]) -> Chart:
    """Depth of a near and a far landmark on the first recording that has traces (the paper's Fig. 4 and 5).

    Raises ValueError where no run has a trace.
    """
    first = series.first_recording([run for run in runs if run.traces] or list(runs))
    colours = filter_colours(run.filter_name for run in runs)
    landmarks = list(dict.fromkeys((t.label, t.landmark_id) for run in first for t in run.traces))[:2]
    if not landmarks:
        raise ValueError("runs must have at least one landmark trace to plot depth convergence")
    room = label_room([*colours, "truth"])
    width = panel_width(2, room, 62.0 + room)
    upper, lower = [], []
    for label, landmark_id in landmarks:
        traces = {
            run.filter_name: trace
            for run in first
            for trace in run.traces
            if trace.landmark_id == landmark_id and len(trace.frames)
        }
        if traces:
            upper.append(_depth_panel(f"{label.capitalize()} landmark, depth ± 1σ (m)", traces, colours, width))
            lower.append(_sigma_panel(traces, colours, width))
    return figure([*upper, *lower], colours, columns=len(upper), column=62 + room, row=56)


def _depth_panel(title: str, traces: dict[str, LandmarkTrace], colours: Mapping[str, str], width: float) -> Panel:
    longest = max(traces.values(), key=lambda trace: len(trace.frames))
    age = (longest.frames - longest.frames[0]).astype(np.float64)
    raw = longest.measured_depth
    finite = [values[np.isfinite(values)] for values in (raw, longest.true_depth, *(t.depth for t in traces.values()))]
    around = np.concatenate(finite)
    low, high = 0.0, 1.0
    if around.size:
        # A far landmark whose disparity touches zero has a measured depth of kilometres: frame the bulk.
        low, high = (float(end) for end in np.percentile(around, [3, 97]))
        pad = 0.25 * (high - low) + 0.02 * abs(high)
        low, high = max(low - pad, 0.0), high + pad
    panel = Panel(Axis(0, max(float(age[-1]), 1.0)), Axis(low, high), width, 180.0, title)
    hidden = int((finite[0] > high).sum())
    panel.note(f"{hidden} raw above" if hidden else "")
    panel.dots([Curve("", age, raw, MUTED, opacity=0.8, said="raw")], 12)
    widths = nested_widths(len(traces))
    ends = []
    if finite[1].size:
        truth = Curve("", age, longest.true_depth, INK, width=widths[0] + 6, opacity=0.18, said="truth")
        panel.lines([truth])
        ends.append(("truth", series.last_known(longest.true_depth), MUTED))
    for (name, trace), line in zip(traces.items(), widths, strict=True):
        x = trace.frames - longest.frames[0]
        sides = (trace.depth - trace.sigma, trace.depth + trace.sigma)
        panel.bands([Curve(name, x, trace.depth, colours[name], *sides, opacity=0.12)])
        panel.lines([Curve(name, x, trace.depth, colours[name], width=line)])
        ends.append((name, series.last_known(trace.depth), colours[name]))
    if finite[0].size:
        ends.append(("raw", series.last_known(raw), MUTED))
    panel.end_labels(ends)
    return panel


def _sigma_panel(traces: dict[str, LandmarkTrace], colours: Mapping[str, str], width: float) -> Panel:
    first = min(int(trace.frames[0]) for trace in traces.values())
    last = max(int(trace.frames[-1]) for trace in traces.values())
    x = Axis(0, max(last - first, 1), "frames since it was first seen")
    panel = Panel(x, log_axis(trace.sigma for trace in traces.values()), width, 180.0, "σ of its depth (m)")
    curves = [
        Curve(name, trace.frames - first, trace.sigma, colours[name], width=line)
        for (name, trace), line in zip(traces.items(), nested_widths(len(traces)), strict=True)
    ]
    panel.lines(curves)
    panel.name_ends(curves)
    return panel


def plot_landmark_errors(summaries: Sequence[FilterSummary]) -> Chart:
    """Error, depth bias and NEES of landmarks by their true distance."""
    with_ranges = [s for s in summaries if s.landmark_by_range]
    colours = filter_colours(s.filter_name for s in summaries)
    ranges = list(dict.fromkeys((e.low_m, e.high_m) for s in with_ranges for e in s.landmark_by_range))
    kinds: tuple[tuple[str, Callable[[RangeError], float], Callable[[RangeError], float], float | None], ...] = (
        ("Landmark RMSE (m)", lambda e: e.rmse_m, lambda e: 0.0, None),
        ("Depth bias ± standard error (m)", lambda e: e.depth_bias_m, lambda e: e.depth_bias_sigma_m, 0.0),
        ("Landmark NEES / 3 (1 is ideal)", lambda e: e.anees / DOF["landmark"], lambda e: 0.0, 1.0),
    )
    panels = []
    for title, value, spread, ideal in kinds:
        curves = _by_range(with_ranges, ranges, colours, value, spread)
        y = _axis_around(ends_of(curves), ideal)
        x = Axis(-0.5, len(ranges) - 0.5, "true distance from the camera (m)", ticks=(), grid=False)
        panel = Panel(x, y, panel_width(3, label_room(colours), 56.0), 200.0, title, zoom=False)
        if ideal is not None:
            panel.rule(y=ideal, dash=DASHED)
        panel.intervals(curves)
        panel.dots(curves, 34)
        panel.column_names(range(len(ranges)), [_range_name(*ends) for ends in ranges])
        panels.append(panel)
    panels[-1].colour_key({s.filter_name: colours[s.filter_name] for s in with_ranges})
    return figure(panels, colours, column=56)


def _by_range(
    summaries: Sequence[FilterSummary],
    ranges: Sequence[tuple[float, float]],
    colours: Mapping[str, str],
    value: Callable[[RangeError], float],
    spread: Callable[[RangeError], float],
) -> list[Curve]:
    """Points of each range side by side, so that none hides another one."""
    offsets = min(0.14, 0.7 / max(len(summaries), 1)) * (np.arange(len(summaries)) - 0.5 * (len(summaries) - 1))
    curves = []
    for s, offset in zip(summaries, offsets, strict=True):
        known = [e for e in s.landmark_by_range if e.count]
        x = np.array([ranges.index((e.low_m, e.high_m)) + offset for e in known])
        y = np.array([value(e) for e in known])
        sides = np.nan_to_num(np.array([spread(e) for e in known]))
        curves.append(Curve(s.filter_name, x, y, colours[s.filter_name], y - sides, y + sides))
    return curves


def _axis_around(values: Sequence[FloatArray], ideal: float | None) -> Axis:
    """Around signed values and 0; of positive ones logarithmic, unless they are near their ideal."""
    everything = np.concatenate([*values, [] if ideal is None else [ideal]])
    finite = everything[np.isfinite(everything)]
    if ideal == 0.0:
        margin = 0.08 * float(np.ptp(finite)) + 1e-6
        return Axis(float(finite.min()) - margin, float(finite.max()) + margin)
    positive = finite[finite > 0]
    if ideal is None or (positive.size and positive.max() > 30 * positive.min()):
        return log_axis([positive])
    return Axis(0.0, 1.15 * float(positive.max(initial=1.0)))


def plot_depth_convergence(summaries: Sequence[FilterSummary]) -> Chart:
    """Depth by the frames since a landmark entered the map: the claimed sigma, and the true error."""
    with_depths = [s for s in summaries if s.depth_convergence]
    colours = filter_colours(s.filter_name for s in summaries)
    kinds = list(dict.fromkeys((c.label, c.low_m, c.high_m) for s in with_depths for c in s.depth_convergence))
    room = label_room(colours)
    gap = 62.0 + room if len(kinds) > 1 else 62.0
    panels = []
    for label, low, high in kinds:
        convergence = {s.filter_name: c for s in with_depths for c in s.depth_convergence if c.label == label}
        panels.append(
            _convergence_panel(
                f"{label.capitalize()}, {low:g} to {high:g} m: σ solid, error dashed (m)",
                convergence,
                colours,
                panel_width(len(kinds), room, gap),
            )
        )
    return figure(panels, colours, column=gap)


def _convergence_panel(
    title: str, found: Mapping[str, DepthConvergence], colours: Mapping[str, str], width: float
) -> Panel:
    frames = [float(frame) for c in found.values() for frame in c.frames]
    y = log_axis(np.array(values, dtype=np.float64) for c in found.values() for values in (c.sigma_m, c.rmse_m))
    x = Axis(min(frames), max(max(frames), min(frames) + 1), "frames since it entered the map")
    panel = Panel(x, y, width, 220.0, title)
    sigma = [Curve(name, c.frames, c.sigma_m, colours[name], said=f"{name}, σ") for name, c in found.items()]
    error = [Curve(name, c.frames, c.rmse_m, colours[name], said=f"{name}, true error") for name, c in found.items()]
    panel.lines(sigma)
    panel.lines(error, DASHED)
    panel.name_ends(sigma)
    return panel


def _range_name(low: float, high: float) -> str:
    return f"{low:g}–{high:g}" if np.isfinite(high) else f"> {low:g}"
