"""Charts of cost: time by stage, along the drive and by the size of the map, state, memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.figures import FIGURES, readable
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.axes import WIDTH, Axis, label_room, panel_width
from stereo_slam_env.report.charts.drawing import ROW, BoxMark, Chart, Curve, Panel, figure
from stereo_slam_env.report.charts.style import filter_colours, shared_limit


def plot_cost(summaries: Sequence[FilterSummary]) -> Chart:
    """Median time of predict and update, dimension of the state and growth of the memory of each filter."""
    names = [s.filter_name for s in summaries]
    colours = filter_colours(names)
    kinds = {"Median time a frame, pale: predict (ms)": FIGURES["ms_per_frame"]}
    if any(s.state_size is not None for s in summaries):
        kinds["State, dimension"] = FIGURES["state_size"]
    if any(s.memory_mb for s in summaries):
        kinds["Memory (MB)"] = FIGURES["memory_mb"]
    left = label_room(names)
    share = (WIDTH - left - 34.0 * len(kinds)) / (len(kinds) + 1)
    panels: list[Panel] = []
    for title, measure in kinds.items():
        values = [s.figures[measure.name] for s in summaries]
        width = 2 * share if not panels else share
        longest = max((value for value in values if value is not None), default=1.0) or 1.0
        y = Axis.of_rows(len(names))
        panel = Panel(Axis(0, 1.22 * longest, "", ticks=None), y, width, ROW * len(names), title, zoom=False)
        if panels:
            panel.boxes(
                _bar(s, row, 0.0, value or 0.0, colours)
                for row, (s, value) in enumerate(zip(summaries, values, strict=True))
            )
        else:
            panel.boxes(bar for row, s in enumerate(summaries) for bar in _times(s, row, colours))
        for row, value in enumerate(values):
            if value is not None:
                x, height = panel.place(value, row)
                panel.text(measure.text(value) + ("" if panels else " ms"), x + 6, height)
        panels.append(panel)
    panels[0].row_names(names, colours)
    return figure(panels, colours, column=34)


def _times(s: FilterSummary, row: int, colours: Mapping[str, str]) -> list[BoxMark]:
    """Predict, pale, and update behind it."""
    if s.ms_per_frame is None:
        return []
    predict = s.ms_predict or 0.0
    update = s.ms_update if s.ms_update is not None else s.ms_per_frame
    return [
        _bar(s, row, 0.0, predict, colours, "predict", opacity=0.45),
        _bar(s, row, predict, predict + update, colours, "update"),
    ]


def _bar(
    s: FilterSummary, row: int, x0: float, x1: float, colours: Mapping[str, str], what: str = "", opacity: float = 1.0
) -> BoxMark:
    said = f"{s.filter_name}, {what}: {readable(x1 - x0)} ms" if what else f"{s.filter_name}: {readable(x1, '.4g')}"
    return BoxMark(x0, x1, row - 0.26, row + 0.26, colours[s.filter_name], s.filter_name, opacity, said)


def plot_time_per_frame(runs: Sequence[FilterRun]) -> Chart:
    """Predict + update: median over runs along the drive, and against the size of the map."""
    groups = series.by_filter(runs)
    colours = filter_colours(groups)
    width = panel_width(2, label_room(colours))
    times = {
        name: series.column_median(series.stack(group, lambda r: r.milliseconds)) for name, group in groups.items()
    }
    by_size = {name: _by_map_size(group) for name, group in groups.items()}
    # One slow frame (a garbage collection, a busy machine) must not set the scale.
    top = {name: float(np.nanpercentile(v, 99)) if np.isfinite(v).any() else np.nan for name, v in times.items()}
    limit = shared_limit(top)
    y = Axis(0, 1.2 * limit.upper)
    seconds = {name: series.elapsed(max(group, key=len)) for name, group in groups.items()}
    last = max(float(found[-1]) for found in seconds.values())
    along = Panel(Axis(0, last, "time (s)"), y, width, 210.0, "Time per frame (ms)")
    along.lines(Curve(name, seconds[name], times[name], colours[name], width=1.2) for name in groups)
    along.note_beyond(limit, colours, " ms")
    sizes = np.concatenate([found for found, _ in by_size.values()])
    low, high = (float(sizes.min()), float(sizes.max())) if sizes.size else (0.0, 1.0)
    beside = 0.04 * (high - low) + 0.5
    x = Axis(low - beside, high + beside, "landmarks in the map")
    over_size = Panel(x, y, width, 210.0, "Time per frame (ms) by size of the map")
    curves = [Curve(name, *by_size[name], colours[name]) for name in groups]
    over_size.lines(curves)
    over_size.dots(curves, 22)
    over_size.name_ends(curves, limit)
    return figure([along, over_size], colours)


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
