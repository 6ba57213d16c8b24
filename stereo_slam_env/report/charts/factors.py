"""Charts of cost, and of studies: what a factor does, which choice of a filter makes the difference, what changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.statistics.attribution import Attribution
from stereo_slam_env.benchmark.statistics.changes import Change
from stereo_slam_env.benchmark.statistics.effects import Effect, ResponseAttribution
from stereo_slam_env.evaluation.figures import FIGURES, readable
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.report.charts import series
from stereo_slam_env.report.charts.axes import (
    BAND,
    INK,
    MUTED,
    PALETTE,
    WIDTH,
    Axis,
    filter_colours,
    label_room,
    log_axis,
    panel_width,
    shared_limit,
)
from stereo_slam_env.report.charts.drawing import ROW, BoxMark, Chart, Curve, Panel, ends_of, figure

_SHOWN = {True: ("effect shown", PALETTE[0]), False: ("no effect shown", MUTED)}


@dataclass(frozen=True, eq=False)
class FactorResponse:
    """One response of every filter at every level of a factor."""

    title: str  # with its unit in brackets
    # Of each filter: mean over seeds and the other factors, and its interval; NaN where not known.
    means: Mapping[str, FloatArray]
    lows: Mapping[str, FloatArray]
    highs: Mapping[str, FloatArray]
    band: tuple[float, float] | None = None  # where a consistent filter would be
    log: bool = True  # whether the axis is logarithmic


def plot_factor(factor: str, levels: Sequence[Any], responses: Sequence[FactorResponse]) -> Chart:
    """Draw every response against the levels of a factor, one line for each filter."""
    names = list(dict.fromkeys(name for response in responses for name in response.means))
    colours = filter_colours(names)
    to_scale = all(isinstance(level, (int, float)) and not isinstance(level, bool) for level in levels)
    places = np.array(levels, dtype=np.float64) if to_scale else np.arange(float(len(levels)))
    width = panel_width(len(responses), label_room(names), 56.0)
    words = [f"{level:g}" if to_scale else str(level) for level in levels]
    tilted = not to_scale and 7.0 * max(len(word) for word in words) > width / len(levels)
    x = _level_axis("" if tilted else factor, places, to_scale=to_scale)
    panels = []
    for response in responses:
        curves = _response_curves(response, names, colours, x, places, joined=to_scale)
        ends = ends_of(curves)
        if response.band is not None:
            ends.append(np.array(response.band))
        top = max((float(np.max(end, initial=0.0)) for end in ends), default=0.0)
        y = log_axis(ends) if response.log else Axis(0.0, 1.08 * top or 1.0)
        panel = Panel(x, y, width, 220.0, response.title)
        if response.band is not None:
            panel.boxes([BoxMark(x.low, x.high, max(response.band[0], y.low), response.band[1], BAND)])
        if to_scale:
            panel.lines(Curve(c.key, c.x, c.y, c.colour, said=None) for c in curves)
        panel.intervals(curves)
        panel.dots(curves, 40)
        if not to_scale:
            panel.zoom = False
            panel.column_names(places.tolist(), words, tilted=tilted)
        panels.append(panel)
    panels[-1].colour_key({name: colours[name] for name in names[:18]})
    return figure(panels, colours, column=56)


def _level_axis(title: str, places: FloatArray, *, to_scale: bool) -> Axis:
    low, high = float(places.min()), float(places.max())
    if not to_scale:
        return Axis(low - 0.5, high + 0.5, title, ticks=(), grid=False)
    if low > 0 and high > 8 * low:
        margin = (high / low) ** 0.05
        return Axis(low / margin, high * margin, title, log=True, ticks=places.tolist())
    margin = 0.05 * (high - low)
    return Axis(low - margin, high + margin, title, ticks=places.tolist())


def _response_curves(
    response: FactorResponse,
    names: Sequence[str],
    colours: Mapping[str, str],
    x: Axis,
    places: FloatArray,
    *,
    joined: bool,
) -> list[Curve]:
    """Filters side by side, so that no interval hides another one."""
    beside = np.linspace(-1.0, 1.0, len(names)) if len(names) > 1 else np.zeros(1)
    curves = []
    for name, share in zip(names, beside, strict=True):
        if name not in response.means:
            continue
        if not joined:
            at = places + 0.3 * share
        elif x.log:
            at = places * (places.max() / places.min()) ** (0.008 * share)
        else:
            at = places + 0.008 * share * float(np.ptp(places))
        mean = response.means[name]
        finite = np.isfinite(mean) & ((mean > 0) | (not response.log))
        low, high = (
            np.where(np.isfinite(ends), ends, mean)[finite] for ends in (response.lows[name], response.highs[name])
        )
        if finite.any():
            curves.append(Curve(name, at[finite], mean[finite], colours[name], low, high))
    return curves


def plot_effects(attribution: Attribution) -> Chart:
    """Main effects of every choice on every response, with their intervals."""
    rows = [(factor, level) for factor, levels in attribution.factors.items() for level in levels]
    names = [f"{factor}: {level}" for factor, level in rows]
    left = label_room(names)
    width = (WIDTH - left - 34.0 * len(attribution.responses)) / len(attribution.responses)
    panels = [_effects_panel(rows, response, width) for response in attribution.responses]
    panels[0].row_names(names, {})
    return figure(panels, dict(_SHOWN.values()), column=34)


def _effects_panel(rows: Sequence[tuple[str, Any]], response: ResponseAttribution, width: float) -> Panel:
    effects = {(effect.factors[0], effect.levels[0]): effect for effect in response.effects}
    drawn = [(row, effects[choice]) for row, choice in enumerate(rows) if choice in effects]
    curves = [_effect_curve(row, effect, names=rows) for row, effect in drawn]
    ends = [*ends_of(curves), np.array([0.98, 1.02])]
    title = response.response[:1].upper() + response.response[1:]
    y = Axis.of_rows(len(rows))
    around = log_axis(ends, "times the average")
    panel = Panel(around, y, width, 24.0 * len(rows), title, zoom=False)
    start = 0
    for factor in dict.fromkeys(name for name, _ in rows):  # a rule between factors
        start += sum(name == factor for name, _ in rows)
        panel.rule(y=start - 0.5, colour=BAND)
    panel.boxes(
        BoxMark(1.0, float(np.asarray(c.x)[0]), row - 0.28, row + 0.28, c.colour, c.key, 0.35)
        for c, (row, _) in zip(curves, drawn, strict=True)
    )
    panel.rule(x=1.0, colour=INK)
    panel.intervals(curves, across=True)
    panel.dots(curves, 40)
    return panel


def _effect_curve(row: int, effect: Effect, names: Sequence[tuple[str, Any]]) -> Curve:
    percent = effect.difference.percent
    low, high = (1 + end / 100 for end in effect.difference.interval_percent or (percent, percent))
    key, colour = _SHOWN[effect.difference.shown]
    return Curve(
        key, [1 + percent / 100], [row], colour, [low], [high], said=": ".join(map(str, names[row])) + f", {key}"
    )


def plot_changes(changes: Sequence[Change]) -> Chart:
    """Draw how much every measure of every filter changed, with its interval."""
    drawable = [change for change in changes if change.interval_percent is not None]
    names = list(dict.fromkeys(change.filter_name for change in drawable))
    measures = list(dict.fromkeys(change.measure for change in drawable))
    colours = filter_colours(names)
    curves = []
    for i, name in enumerate(names):
        of_filter = [change for change in drawable if change.filter_name == name]
        rows = [measures.index(change.measure) - 0.3 + 0.6 * (i + 0.5) / len(names) for change in of_filter]
        ends = 1 + np.array([change.interval_percent for change in of_filter], dtype=np.float64) / 100
        curves.append(Curve(name, np.sqrt(ends[:, 0] * ends[:, 1]), rows, colours[name], ends[:, 0], ends[:, 1]))
    title = "after / before, geometric mean; of consistency: distance from the ideal"
    x = log_axis([*ends_of(curves), np.array([0.98, 1.02])], title)
    left, right = label_room(measures), label_room(names)
    y = Axis.of_rows(len(measures))
    panel = Panel(x, y, WIDTH - left - right - 20, 15.0 * len(measures) * max(len(names), 2), zoom=False)
    panel.rule(x=1.0, colour=INK)
    panel.intervals(curves, across=True)
    panel.dots(curves, 34)
    panel.row_names(measures, {})
    panel.colour_key(colours)
    return figure([panel], colours)


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
    tooltip = f"{s.filter_name}, {what}: {readable(x1 - x0)} ms" if what else f"{s.filter_name}: {readable(x1, '.4g')}"
    return BoxMark(x0, x1, row - 0.26, row + 0.26, colours[s.filter_name], s.filter_name, opacity, tooltip)


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
    last = max(float(seconds_of[-1]) for seconds_of in seconds.values())
    along = Panel(Axis(0, last, "time (s)"), y, width, 210.0, "Time per frame (ms)")
    along.lines(Curve(name, seconds[name], times[name], colours[name], width=1.2) for name in groups)
    along.note_beyond(limit, colours, " ms")
    sizes = np.concatenate([seconds_of for seconds_of, _ in by_size.values()])
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
    usable = np.isfinite(times) & (sizes > 0)
    if not usable.any():
        return np.zeros(0), np.zeros(0)
    edges = np.unique(np.quantile(sizes[usable], np.linspace(0, 1, bins + 1)))
    which = np.clip(np.searchsorted(edges, sizes[usable], side="right"), 1, max(len(edges) - 1, 1))
    filled = np.unique(which)
    return (
        np.array([np.median(sizes[usable][which == b]) for b in filled]),
        np.array([np.median(times[usable][which == b]) for b in filled]),
    )
