"""Tables of a report: every figure of every filter, sortable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stereo_slam_env.benchmark.statistics.differences import Finding
from stereo_slam_env.benchmark.statistics.limit import limit_reached
from stereo_slam_env.benchmark.statistics.pairwise import PairVerdict, PairwiseTable
from stereo_slam_env.benchmark.statistics.words import signed
from stereo_slam_env.evaluation.results import ConsistencyFigure, FilterSummary
from stereo_slam_env.report.charts.style import filter_colours
from stereo_slam_env.report.page_tables import Cell, Column, Tone, filter_cell, number, table

_Value = Callable[[FilterSummary], float | None]


@dataclass(frozen=True)
class _Figure:
    heading: str
    unit: str
    explanation: str
    value: _Value
    form: str


_ACCURACY = (
    _Figure("Position", "RMSE, m", "without alignment", lambda s: s.position_rmse_m, ".3f"),
    _Figure("Rotation", "RMSE, °", "angle of the rotation error", lambda s: s.rotation_rmse_deg, ".3f"),
    _Figure("Velocity", "RMSE, m/s", "linear velocity", lambda s: s.velocity_rmse_m_s, ".3f"),
    _Figure("ATE", "rigid, m", "after rigid alignment, median over runs", lambda s: s.ate_rigid_m, ".3f"),
    _Figure("Drift", "end, %", "final error over distance, mean", lambda s: s.end_drift_percent, ".3f"),
    _Figure(
        "t_rel", "%", "relative translation error over segments, KITTI", lambda s: s.rpe_translation_percent, ".3f"
    ),
    _Figure("r_rel", "°/100 m", "relative rotation error over segments", lambda s: s.rpe_rotation_deg_per_100m, ".3f"),
    _Figure("Limit", "position, m", "posterior Cramér–Rao bound", lambda s: s.bound_position_m, ".3f"),
    _Figure("Limit", "rotation, °", "posterior Cramér–Rao bound", lambda s: s.bound_rotation_deg, ".3f"),
    _Figure("Efficiency", "95 % interval", "bound over RMSE of the position", lambda s: s.efficiency_percent, ".0f"),
    _Figure("Landmarks", "error, m", "relative to the camera", lambda s: s.landmark_rmse_m, ".2f"),
)

_COST = (
    _Figure("Time", "ms/frame", "median of predict + update", lambda s: s.ms_per_frame, ".2f"),
    _Figure("Predict", "ms", "median", lambda s: s.ms_predict, ".2f"),
    _Figure("Update", "ms", "median", lambda s: s.ms_update, ".2f"),
    _Figure("State", "dimension", "median of the error state", lambda s: s.state_size, ".0f"),
    _Figure("Memory", "MB", "largest growth of a trial's resident memory", lambda s: s.memory_mb, ".1f"),
    _Figure("Gated", "%", "known measurements refused", lambda s: s.gated_percent, ".1f"),
    _Figure("Rejected", "count", "measurements that could not start a landmark", lambda s: s.rejected, "d"),
    _Figure("Behind", "count", "landmarks behind the camera", lambda s: s.behind_camera, "d"),
    _Figure("Failed", "factorisations", "Cholesky factors that failed", lambda s: s.failed_factorisations, "d"),
    _Figure("d ≤ 0", "count", "landmarks x frames with no positive depth", lambda s: s.negative_depth, "d"),
)

_QUANTITIES = {
    "pose": "Pose NEES",
    "position": "Position NEES",
    "rotation": "Rotation NEES",
    "landmark": "Landmark NEES",
    "nis": "NIS / dof",
}


def accuracy_table(summaries: Sequence[FilterSummary], who: str = "Filter") -> str:
    """Errors of pose, velocity and map, and the distance from the limit; a row is called `who`."""
    return _table(summaries, _ACCURACY, who)


def cost_table(summaries: Sequence[FilterSummary], who: str = "Filter") -> str:
    """Time, memory and events."""
    return _table(summaries, _COST, who, diverged=True)


def consistency_table(summaries: Sequence[FilterSummary], who: str = "Filter") -> str:
    """Mean NEES and NIS in their bands, and how much of the time they are inside; "" where nothing is known."""
    keys = [key for key in _QUANTITIES if any(key in s.consistency for s in summaries)]
    if not keys:
        return ""
    columns = [Column(who, kind="text")]
    for key in keys:
        bands = {s.consistency[key].band for s in summaries if key in s.consistency}
        dof = next(s.consistency[key].dof for s in summaries if key in s.consistency)
        low, high = next(iter(bands))
        band = f", {low / dof:.2f}–{high / dof:.2f}" if len(bands) == 1 else ""
        what = _QUANTITIES[key] if key == "nis" else f"{_QUANTITIES[key]} / {dof:g}"
        columns.append(Column(what, f"ideal 1{band}", "mean over frames and runs, 95 % band"))
        columns.append(Column("inside", "% frames", f"{_QUANTITIES[key]}: mean over runs inside the band of its frame"))
    colours = filter_colours(s.filter_name for s in summaries)
    rows = []
    for s in summaries:
        row = [filter_cell(s.filter_name, colours)]
        for key in keys:
            found = s.consistency.get(key)
            row += [_in_band(found), number(found.inside_percent if found else None, ".0f")]
        rows.append(row)
    return table(columns, rows, wide=True)


def pair_table(compared: PairwiseTable, who: str = "Filter") -> str:
    """A row for each pair of filters, a column for each question."""
    columns = [Column(who, kind="text"), Column("against", kind="text")]
    for measure in compared.measures:
        unit = "nearness to 1" if measure.ideal is not None else "%" if measure.is_ratio else "difference"
        columns.append(Column(capital(measure.words), unit))
    colours = filter_colours(compared.filters)
    pairs = list(dict.fromkeys((a, b) for _, a, b in compared.cells))
    order = {name: i for i, name in enumerate(compared.filters)}
    rows = []
    for a, b in pairs:
        if (b, a) in pairs and order[a] > order[b]:
            continue
        found = (compared.cell(measure, a, b) for measure in compared.measures)
        rows.append([filter_cell(a, colours), filter_cell(b, colours), *map(pair_cell, found)])
    return table(columns, rows, wide=True)


_FINDING_TONES: dict[Finding, Tone] = {Finding.BETTER: "good", Finding.WORSE: "bad", Finding.NOT_SHOWN: "none"}


def finding_tone(finding: Finding) -> Tone:
    """How a finding is coloured."""
    return _FINDING_TONES[finding]


def pair_cell(verdict: PairVerdict | None) -> Cell:
    """Difference and interval; of consistency, which is nearer to its ideal."""
    if verdict is None:
        return number(None)
    difference, tone = verdict.difference, finding_tone(verdict.finding)
    if difference.tied:
        return Cell("tie", difference.estimate, tone)
    if verdict.measure.ideal is not None:
        nearer = {Finding.BETTER: "nearer", Finding.WORSE: "farther"}.get(verdict.finding, Finding.NOT_SHOWN.value)
        return Cell(nearer, difference.estimate, tone)
    if not verdict.measure.is_ratio:
        interval = f" ({difference.interval_words})" if difference.interval is not None else ""
        return Cell(f"{signed(difference.estimate, 2)}{interval}", difference.estimate, tone)
    return percent_cell(difference.percent, difference.interval_percent, tone)


def percent_cell(percent: float, interval: tuple[float, float] | None, tone: Tone) -> Cell:
    """A change in %, with its interval in brackets where there is one."""
    text = signed(percent)
    if interval is not None:
        text += f" ({' to '.join(signed(end) for end in interval)})"
    return Cell(text, percent, tone)


def capital(words: str) -> str:
    """With a capital at the start, and the rest as it is: "Pose NEES"."""
    return words[:1].upper() + words[1:]


def _in_band(figure: ConsistencyFigure | None) -> Cell:
    if figure is None:
        return number(None)
    low, high = figure.band
    tone: Tone = "bad" if figure.mean > high else "fair" if figure.mean < low else "good"
    return number(figure.mean / figure.dof, ".2f", tone=tone)


def _table(summaries: Sequence[FilterSummary], figures: Sequence[_Figure], who: str, *, diverged: bool = False) -> str:
    shown = [f for f in figures if any(_known(f.value(s)) for s in summaries)]
    columns = [Column(who, kind="text")] + [Column(f.heading, f.unit, f.explanation) for f in shown]
    colours = filter_colours(s.filter_name for s in summaries)
    rows = [[filter_cell(s.filter_name, colours), *(_figure_cell(f, s) for f in shown)] for s in summaries]
    if diverged:
        columns.append(Column("Diverged", "runs", "failed, not finite, or far from the truth"))
        columns.append(Column("Alarms", "runs", "the divergence monitor warned, by innovations and events alone"))
        for s, row in zip(summaries, rows, strict=True):
            row.append(Cell(f"{s.diverged}/{s.runs}", float(s.diverged), "bad" if s.diverged else ""))
            row.append(Cell(f"{s.alarmed}/{s.runs}", float(s.alarmed), "fair" if s.alarmed else ""))
    return table(columns, rows, wide=True)


def _figure_cell(figure: _Figure, summary: FilterSummary) -> Cell:
    if figure.heading == "Efficiency":
        return efficiency_cell(summary)
    return number(figure.value(summary), figure.form)


def efficiency_cell(summary: FilterSummary) -> Cell:
    """Bound over RMSE with its interval, or that it is at the limit."""
    found = limit_reached(summary)
    return number(None) if found is None else Cell(found.words, found.percent)


def _known(value: float | None) -> bool:
    return value is not None and bool(np.isfinite(value))
