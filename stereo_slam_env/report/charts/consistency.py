"""Charts of honesty: whether a filter knows how wrong it is. 3-sigma bounds, NEES, NIS, depth and map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import DOF, mean_bands
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.axes import WIDTH, Axis, label_room, panel_width
from stereo_slam_env.report.charts.drawing import DASHED, Box, Chart, Curve, Panel, figure, limit_of
from stereo_slam_env.report.charts.style import BAND, MUTED, filter_colours, shared_limit, short_number

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

    A diverged filter does not count: the others stay readable.
    """
    peaks = {run.filter_name: np.zeros(6) for run in runs}
    for run in runs:
        error, sigma = series.belief_error(run)
        reach = np.stack([np.abs(error), 3 * sigma])
        peaks[run.filter_name] = np.array([series.peak(reach[:, :, axis]) for axis in range(6)])
    limits = [shared_limit({n: float(p[axis]) for n, p in peaks.items()}).upper for axis in range(6)]
    return np.array(limits)


def plot_error_bounds(run: FilterRun, limits: FloatArray | None = None) -> Chart:
    """Pose error inside its claimed 3-sigma bounds, one panel per degree of freedom."""
    name = run.filter_name
    colour = filter_colours([name])[name]
    limits = error_limits([run]) if limits is None else limits
    error, sigma = series.belief_error(run)
    time = series.elapsed(run)
    panels = []
    for number, (title, axis, unit, scale) in enumerate(_PANELS):
        e, bound = scale * error[:, axis], 3 * scale * sigma[:, axis]
        half = 1.12 * float(scale * limits[axis])
        x = Axis(0, float(time[-1]), "time (s)" if number >= 3 else "")
        panel = Panel(x, Axis(-half, half), panel_width(3, 10.0, 52.0), 140.0, f"{title} ({unit})")
        panel.bands([Curve("", time, e, colour, -bound, bound, opacity=0.13)])
        side = {"width": 0.9, "opacity": 0.45}
        panel.lines(Curve("", time, end, colour, said=said, **side) for end, said in ((bound, "3σ"), (-bound, "3σ")))
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
    return _against_band(title, series.elapsed(max(runs, key=len)), curves, (low, high))


def plot_nis(runs: Sequence[FilterRun], points: int = 80) -> Chart:
    """NIS per degree of freedom with its two-sided 95 % band, pooled over runs and short stretches of time.

    A consistent filter's innovations are white, so frames may be pooled (those of NEES may not).
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
    fewest = np.min(dofs, axis=0)
    band = mean_bands(1, np.where(fewest > 0, fewest, np.nan))
    return _against_band("NIS per degree of freedom (1 is ideal)", time[starts], curves, band)


def _against_band(
    title: str, time: FloatArray, curves: Mapping[str, FloatArray], band: tuple[FloatArray, FloatArray]
) -> Chart:
    """Curves, of which 1 is ideal, on a log axis (twice too large and too small look alike) over the band."""
    low, high = band
    colours = filter_colours(curves)
    known = np.isfinite(low)
    lines = [
        Curve(name, time, np.where(curve > 0, curve, np.nan), colours[name], width=1.4)
        for name, curve in curves.items()
    ]
    limit = limit_of(lines, spread=100.0)
    floor = min((float(np.percentile(c[c > 0], 1)) for c in curves.values() if (c > 0).any()), default=0.1)
    bottom = max(min(floor, float(low[known].min(initial=np.inf))), 0.02)
    top = max(limit.upper, float(high[known].max(initial=0.0)), 1.01 * bottom)
    margin = (top / bottom) ** 0.06
    y = Axis(bottom / margin, top * margin, log=True)
    width = panel_width(1, label_room([*curves, "95 % band"]))
    panel = Panel(Axis(0, float(time[-1]), "time (s)"), y, width, 250.0, title)
    # What goes below 0.02 is drawn at the lower end: 0 has no place on a logarithmic axis.
    panel.bands([Curve("", time, low, BAND, np.maximum(low, y.low), high)])
    panel.rule(y=1.0, dash=DASHED)
    panel.lines(lines)
    panel.note_beyond(limit, colours)
    centre = float(np.sqrt(low[known][-1] * high[known][-1])) if known.any() else np.nan
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
    shown = [v for c in means for v in np.atleast_1d(np.asarray(c.x)) if np.isfinite(v) and v > 0]
    low = 0.85 * min([*shown, *(box.x0 for box in boxes if box.x0 > 0), 1.0])
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


def _row_bands(summaries: Sequence[FilterSummary], keys: Sequence[str], step: float) -> list[Box]:
    """One band for the row of a quantity where it is the same for all, else one for each filter."""
    boxes = []
    for row, key in enumerate(keys):
        found = [(i, s.consistency[key]) for i, s in enumerate(summaries) if key in s.consistency]
        bands = {(figures.band[0] / figures.dof, figures.band[1] / figures.dof) for _, figures in found}
        if len(bands) == 1:
            boxes.append(Box(*bands.pop(), row - 0.35, row + 0.35, BAND))
            continue
        for i, figures in found:
            top = row - 0.35 + i * step
            boxes.append(Box(figures.band[0] / figures.dof, figures.band[1] / figures.dof, top, top + step, BAND))
    return boxes
