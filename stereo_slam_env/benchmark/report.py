"""The report: one self-contained page that says who did best, by how much, how honestly and at what cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stereo_slam_env.benchmark.results import FilterRun, FilterSummary
from stereo_slam_env.benchmark.verdict import Consistency, Verdict, consistency, judge
from stereo_slam_env.viewer import consistency as honesty
from stereo_slam_env.viewer import plots, series
from stereo_slam_env.viewer.figures import CSS_VARIABLES, inline_svg, save_png
from stereo_slam_env.viewer.style import filter_colours


def write_report(
    out: Path,
    title: str,
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    settings: Mapping[str, Any],
) -> Path:
    """Write `out/report.html`, and each of its figures as `out/figures/<name>.png`.

    Parameters
    ----------
    out : Path
        Directory; made if it is not there.
    title : str
        Heading of the page.
    runs : sequence of FilterRun
        All runs of all filters.
    summaries : sequence of FilterSummary
        One for each filter, of the same runs.
    settings : mapping
        What was asked for (scenario, noise, gate, seeds, versions); JSON-able, may be nested.

    Returns
    -------
    Path
        The page. It needs nothing but itself.

    Raises
    ------
    ValueError
        No runs, or no summaries.
    """
    if not runs or not summaries:
        raise ValueError("runs and summaries must not be empty: there is nothing to report")
    folder = out / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob("*.png"):
        stale.unlink()
    verdict = judge(runs, summaries)
    page = Template(files(__package__).joinpath("report.html").read_text(encoding="utf-8"))
    html = page.substitute(
        title=escape(title),
        subtitle=escape(_subtitle(runs)),
        headline=escape(verdict.headline),
        cards="\n".join(_cards(summaries, verdict)),
        table=_table(summaries),
        table_note=escape(_table_note(summaries)),
        sections="\n".join([*(_section(section, folder) for section in _sections(runs)), _failures(summaries)]),
        settings=_settings(settings),
    )
    path = out / "report.html"
    path.write_text(html, encoding="utf-8")
    return path


# ---- first screen ---------------------------------------------------------------------------------------------------


def _subtitle(runs: Sequence[FilterRun]) -> str:
    recordings = dict.fromkeys((run.recording_name, run.seed) for run in runs)
    first = series.first_recording(runs)[0]
    length = series.last_known(series.distance(first))
    parts = [
        f"{len(series.by_filter(runs))} filters on identical measurements",
        f"{len(recordings)} recordings" if len(recordings) > 1 else f"1 recording ({first.recording_name})",
        f"{len(first)} frames" + (f" over {length:.0f} m" if np.isfinite(length) else ""),
    ]
    return " · ".join(parts)


def _cards(summaries: Sequence[FilterSummary], verdict: Verdict) -> list[str]:
    colours = filter_colours(s.filter_name for s in summaries)
    quickest = min((s.ms_per_frame for s in summaries if s.ms_per_frame), default=None)

    def card(question: str, measure: str, row: Callable[[FilterSummary], tuple[str, str, str]]) -> str:
        lines = []
        for summary in summaries:
            value, tone, remark = row(summary)
            name = _filter_cell(summary.filter_name, colours)
            lines.append(f'<tr>{name}<td>{value}</td><td class="{tone}">{escape(remark)}</td></tr>')
        body = "".join(lines)
        return f'<div class="card"><h3>{question} <span>{measure}</span></h3><table>{body}</table></div>'

    def accuracy(s: FilterSummary) -> tuple[str, str, str]:
        value = _short(s.position_rmse_m, " m")
        if s.diverged:
            return value, "bad", f"diverged {s.diverged}/{s.runs}"
        if s.filter_name == verdict.best:
            alone = all(c.shown for c in verdict.comparisons.values())
            return value, "good" if alone else "none", "best" if alone else "smallest"
        comparison = verdict.comparisons.get(s.filter_name)
        if comparison is None or not np.isfinite(comparison.excess_percent):
            return value, "none", "–"
        if not comparison.shown:
            return value, "none", "gap not shown"
        return value, "bad", f"{comparison.excess_percent:+,.0f} %"

    def honest(s: FilterSummary) -> tuple[str, str, str]:
        state = consistency(s)
        tones = {
            Consistency.CONSISTENT: "good",
            Consistency.OVERCONFIDENT: "bad",
            Consistency.CAUTIOUS: "fair",
            Consistency.UNKNOWN: "none",
        }
        return _short(s.pose_anees), tones[state], state.value

    def cost(s: FilterSummary) -> tuple[str, str, str]:
        if s.ms_per_frame is None or not quickest:
            return "–", "none", ""
        ratio = s.ms_per_frame / quickest
        return f"{s.ms_per_frame:.2f} ms", "none", "quickest" if ratio == 1 else f"{ratio:.2f} ×"

    bands = {s.pose_anees_band for s in summaries if s.pose_anees_band is not None}
    band = "–".join(f"{bound:.2f}" for bound in next(iter(bands))) if len(bands) == 1 else "of each"
    return [
        card("How accurate?", "position RMSE", accuracy),
        card("How honest?", f"pose NEES, band {band}" if bands else "pose NEES", honest),
        card("How fast?", "median time per frame", cost),
    ]


@dataclass(frozen=True)
class _Column:
    heading: str
    unit: str
    explanation: str
    value: Callable[[FilterSummary], float | None]
    form: str


_COLUMNS = (
    _Column("Position", "RMSE, m", "without alignment", lambda s: s.position_rmse_m, ".3f"),
    _Column("Rotation", "RMSE, °", "angle of the rotation error", lambda s: s.rotation_rmse_deg, ".3f"),
    _Column("ATE", "rigid, m", "after rigid alignment, median over runs", lambda s: s.ate_rigid_m, ".3f"),
    _Column("Drift", "end, %", "final error over distance, mean", lambda s: s.end_drift_percent, ".3f"),
    _Column("Pose NEES", "ideal 6", "mean over frames and runs", lambda s: s.pose_anees, ".2f"),
    _Column("In band", "% frames", "NEES averaged over runs", lambda s: s.frames_in_band_percent, ".0f"),
    _Column("NIS", "ideal 1", "normalised innovation squared per degree of freedom", lambda s: s.nis, ".2f"),
    _Column("Map NEES", "ideal 3", "landmarks in (u, v, d)", lambda s: s.landmark_anees, ".2f"),
    _Column("Map error", "m", "landmarks relative to the camera", lambda s: s.landmark_rmse_m, ".2f"),
    _Column("Time", "ms/frame", "median of predict + update", lambda s: s.ms_per_frame, ".2f"),
    _Column("Gated", "%", "known measurements refused", lambda s: s.gated_percent, ".1f"),
    _Column("Diverged", "runs", "failed, not finite, or far from the truth", lambda s: float(s.diverged), ".0f"),
)


def _table(summaries: Sequence[FilterSummary]) -> str:
    colours = filter_colours(s.filter_name for s in summaries)
    shown = [c for c in _COLUMNS if any(_finite(c.value(s)) for s in summaries)]
    heads = ["<th><button>Filter<small>&nbsp;</small></button></th>"] + [
        f'<th title="{escape(c.explanation)}"><button>{c.heading}<small>{c.unit}</small></button></th>' for c in shown
    ]
    rows = []
    for summary in summaries:
        cells = [_filter_cell(summary.filter_name, colours)]
        for column in shown:
            cells.append(_cell(column, column.value(summary), summary))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    return f'<table class="results"><thead><tr>{"".join(heads)}</tr></thead><tbody>{"".join(rows)}</tbody></table>'


def _cell(column: _Column, value: float | None, summary: FilterSummary) -> str:
    if value is None or not np.isfinite(value):
        return '<td class="none" data-value="">–</td>'
    text = format(value, column.form) if abs(value) < 10_000 else f"{value:.1e}"
    if column.heading == "Diverged":
        tone = ' class="bad"' if value else ""
        return f'<td{tone} data-value="{value}">{text}/{summary.runs}</td>'
    return f'<td data-value="{value!r}">{text}</td>'


def _table_note(summaries: Sequence[FilterSummary]) -> str:
    note = "Click a column to sort by it."
    if any(s.frames_in_band_percent is not None for s in summaries):
        note += (
            " NEES is correlated in time, so even a consistent filter has fewer than 95 % of its frames in the band:"
            " do not rank filters by it between about 88 and 96 %."
        )
    return note


# ---- figures --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Section:
    name: str
    heading: str
    guide: str
    figures: Mapping[str, Figure]


def _sections(runs: Sequence[FilterRun]) -> list[_Section]:
    first = series.first_recording(runs)
    with_truth = any(series.scored(run).any() for run in runs)
    several = len({(run.recording_name, run.seed) for run in runs}) > 1
    of_first = f"Shown: {first[0].recording_name}" + (f", seed {first[0].seed}." if first[0].seed is not None else ".")
    sections = []
    if with_truth and several:
        guide = "A line joins the filters' errors on the same recording: look at its direction, not at the spread."
        sections.append(_Section("runs", "Run by run", guide, {"error_by_run": plots.plot_error_by_run(runs)}))
    guide = f"{of_first} " + ("Errors: all runs, single ones thin; no alignment." if with_truth else "")
    sections.append(_Section("path", "Trajectory", guide, {"trajectory": plots.plot_trajectory(runs)}))
    if with_truth:
        nees = {"nees": honesty.plot_nees(runs)} if any(np.isfinite(r.pose_nees).any() for r in runs) else {}
        guide = "Above the band a filter is overconfident, below it too cautious. The scale is logarithmic."
        sections.append(_Section("nees", "Consistency", guide, nees | {"nis": honesty.plot_nis(runs)}))
        limits = honesty.error_limits(first)
        bounds = {f"error_{i}": honesty.plot_error_bounds(run, limits) for i, run in enumerate(first)}
        guide = f"{of_first} Position in the world, rotation in the camera frame; equal scales for all filters."
        sections.append(_Section("errors", "Errors and their 3σ bounds", guide, bounds))
    else:
        guide = "Above the band a filter is overconfident, below it too cautious."
        sections.append(_Section("nis", "Consistency", guide, {"nis": honesty.plot_nis(runs)}))
    if any(run.traces for run in runs):
        guide = "Dots: depth from the frame's own disparity. A narrow band that misses the truth is false confidence."
        sections.append(_Section("depth", "Depth convergence", guide, {"depth": honesty.plot_depth(runs)}))
    sections.append(_Section("speed", "Velocity and heading", of_first, {"velocity": plots.plot_velocity(runs)}))
    guide = "Predict and update, median over runs. Compare filters within a report, not across machines."
    sections.append(_Section("cost", "Cost", guide, {"time_per_frame": plots.plot_time_per_frame(runs)}))
    return sections


def _section(section: _Section, folder: Path) -> str:
    parts = [f"<section><h2>{section.heading}</h2>", f'<p class="quiet">{escape(section.guide)}</p>']
    for name, figure in section.figures.items():
        save_png(figure, folder / f"{name}.png")
        markup = inline_svg(figure, name, escape(f"{section.heading}: {name.replace('_', ' ')}"))
        parts.append(f'<figure><div class="scroll">{markup}</div></figure>')
    return "\n".join([*parts, "</section>"])


# ---- the rest -------------------------------------------------------------------------------------------------------


def _failures(summaries: Sequence[FilterSummary]) -> str:
    lines = [f"<li>{escape(f'{s.filter_name}: {failure}')}</li>" for s in summaries for failure in s.failures]
    if not lines:
        return ""
    return f'<section><h2>Failures</h2><ul class="failures">{"".join(lines)}</ul></section>'


def _settings(settings: Mapping[str, Any]) -> str:
    entries = "".join(f"<dt>{escape(str(key))}</dt><dd>{_setting(value)}</dd>" for key, value in settings.items())
    return f'<dl class="settings">{entries}</dl>'


def _setting(value: Any) -> str:
    if isinstance(value, Mapping):
        return _settings(value) if value else "none"
    if isinstance(value, (list, tuple)):
        if value and all(isinstance(item, Mapping) for item in value):
            return "<br>".join(escape(_in_one_line(item)) for item in value)
        return escape(", ".join(map(str, value))) or "none"
    return escape("none" if value is None else str(value))


def _in_one_line(value: Mapping[str, Any]) -> str:
    parts = (f"{key} {_in_one_line(v) if isinstance(v, Mapping) else v}" for key, v in value.items())
    return ", ".join(parts) or "none"


def _filter_cell(name: str, colours: Mapping[str, str]) -> str:
    variable = CSS_VARIABLES[colours[name]]
    label = escape(name)
    return f'<td class="filter" style="--colour: var({variable})" data-value="{label}">{label}</td>'


def _finite(value: float | None) -> bool:
    return value is not None and bool(np.isfinite(value))


def _short(value: float | None, unit: str = "") -> str:
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.3g}{unit}" if abs(value) < 10_000 else f"{value:.1e}{unit}"
