"""Charts of the map: error and depth of landmarks by distance, and how their depth converges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import DOF
from stereo_slam_env.evaluation.landmark_statistics import DepthConvergence, RangeError
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.axes import Axis, label_room, log_axis, panel_width
from stereo_slam_env.report.charts.drawing import DASHED, Chart, Curve, Panel, ends_of, figure
from stereo_slam_env.report.charts.style import INK, MUTED, filter_colours, nested_widths


def plot_depth(runs: Sequence[FilterRun]) -> Chart:
    """Depth of a near and a far landmark on the first recording that has traces (the paper's Fig. 4 and 5).

    Raises ValueError where no run has a trace.
    """
    shown = series.first_recording([run for run in runs if run.traces] or list(runs))
    colours = filter_colours(run.filter_name for run in runs)
    landmarks = list(dict.fromkeys((t.label, t.landmark_id) for run in shown for t in run.traces))[:2]
    if not landmarks:
        raise ValueError("runs must have at least one landmark trace to plot depth convergence")
    room = label_room([*colours, "truth"])
    width = panel_width(2, room, 62.0 + room)
    upper, lower = [], []
    for label, landmark_id in landmarks:
        traces = {
            run.filter_name: trace
            for run in shown
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
    shown = [s for s in summaries if s.landmark_by_range]
    colours = filter_colours(s.filter_name for s in summaries)
    ranges = list(dict.fromkeys((e.low_m, e.high_m) for s in shown for e in s.landmark_by_range))
    kinds: tuple[tuple[str, Callable[[RangeError], float], Callable[[RangeError], float], float | None], ...] = (
        ("Landmark RMSE (m)", lambda e: e.rmse_m, lambda e: 0.0, None),
        ("Depth bias ± standard error (m)", lambda e: e.depth_bias_m, lambda e: e.depth_bias_sigma_m, 0.0),
        ("Landmark NEES / 3 (1 is ideal)", lambda e: e.anees / DOF["landmark"], lambda e: 0.0, 1.0),
    )
    panels = []
    for title, value, spread, ideal in kinds:
        curves = _by_range(shown, ranges, colours, value, spread)
        y = _axis_around(ends_of(curves), ideal)
        x = Axis(-0.5, len(ranges) - 0.5, "true distance from the camera (m)", ticks=(), grid=False)
        panel = Panel(x, y, panel_width(3, label_room(colours), 56.0), 200.0, title, zoom=False)
        if ideal is not None:
            panel.rule(y=ideal, dash=DASHED)
        panel.lines(Curve(c.key, c.x, c.y, c.colour, width=1.0, said=None) for c in curves)
        panel.intervals(curves)
        panel.dots(curves, 34)
        panel.column_names(range(len(ranges)), [_range_name(*ends) for ends in ranges])
        panels.append(panel)
    panels[-1].colour_key({s.filter_name: colours[s.filter_name] for s in shown})
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
    known = everything[np.isfinite(everything)]
    if ideal == 0.0:
        margin = 0.08 * float(np.ptp(known)) + 1e-6
        return Axis(float(known.min()) - margin, float(known.max()) + margin)
    positive = known[known > 0]
    if ideal is None or (positive.size and positive.max() > 30 * positive.min()):
        return log_axis([positive])
    return Axis(0.0, 1.15 * float(positive.max(initial=1.0)))


def plot_depth_convergence(summaries: Sequence[FilterSummary]) -> Chart:
    """Depth by the frames since a landmark entered the map: the claimed sigma, and the true error."""
    shown = [s for s in summaries if s.depth_convergence]
    colours = filter_colours(s.filter_name for s in summaries)
    kinds = list(dict.fromkeys((c.label, c.low_m, c.high_m) for s in shown for c in s.depth_convergence))
    room = label_room(colours)
    gap = 62.0 + room if len(kinds) > 1 else 62.0
    panels = []
    for label, low, high in kinds:
        found = {s.filter_name: c for s in shown for c in s.depth_convergence if c.label == label}
        panels.append(
            _convergence_panel(
                f"{label.capitalize()}, {low:g} to {high:g} m: σ solid, error dashed (m)",
                found,
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
