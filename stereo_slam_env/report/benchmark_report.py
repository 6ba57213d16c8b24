"""Report of a benchmark: a page for each cell, and one over all cells of a grid."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.statistics.attribution import Attribution, attribute_runs
from stereo_slam_env.benchmark.statistics.differences import CONFIDENCE, MIN_PAIRS, Finding
from stereo_slam_env.benchmark.statistics.measures import EFFICIENCY, POSE_NEES, POSITION
from stereo_slam_env.benchmark.statistics.policy_verdict import Looks, baseline_of
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.benchmark.statistics.verdict import Verdict, consistency, judge
from stereo_slam_env.benchmark.storage.result_tables import CellResult
from stereo_slam_env.benchmark.storage.run_files import seed_name
from stereo_slam_env.benchmark.storage.store import StudyDirectory
from stereo_slam_env.evaluation.bands import DOF, mean_band, studentised_interval
from stereo_slam_env.evaluation.figures import Figure
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.report.charts.axes import filter_colours
from stereo_slam_env.report.charts.factors import FactorResponse, plot_factor
from stereo_slam_env.report.comparison_report import attribution_section, conclusions
from stereo_slam_env.report.overview import RUN_BY_RUN, TONES, colour_key, lost
from stereo_slam_env.report.page import Content, Drawing, Section, clean_figures, data_section, part, write_page
from stereo_slam_env.report.run_report import reference_banner, write_report
from stereo_slam_env.report.table import Column, Table, TableCell, Tone, filter_cell, number
from stereo_slam_env.report.tables import (
    FINDING_TONES,
    capital,
    console_columns,
    figure_cell,
    figure_column,
    percent_cell,
)

_log = logging.getLogger(__name__)


def write_study_report(
    out: Path, study: Study, results: Mapping[str, CellResult], attribution: Attribution | None = None
) -> Path:
    """Write `out/report.html` over all cells of a study; each has its own report at `out/cells/<name>/report.html`.

    `results` is by name of the cell, and cells without are left out; without any a `ValueError` says so. Returns the
    page.
    """
    results = {cell.name: results[cell.name] for cell in study.cells if cell.name in results}
    if not results:
        raise ValueError("results must hold at least one cell of the study: there is nothing to report")
    clean_figures(out)
    verdicts = {name: judge(outcome.summaries, outcome.figures) for name, outcome in results.items()}
    pages = {name: f"cells/{name}/report.html" for name in results}
    links = {name: page if len(study.cells) > 1 or (out / page).is_file() else "" for name, page in pages.items()}
    names = list(dict.fromkeys(s.filter_name for outcome in results.values() for s in outcome.summaries))
    contents: list[Content] = [
        reference_banner([run for outcome in results.values() for run in outcome.runs]),
        conclusions(attribution)
        if attribution is not None
        else part("paragraph", " ".join(_sentences(verdicts, names)), "headline"),
        _matrix(results, verdicts, names, links),
        part("paragraph", _MATRIX_NOTE),
        colour_key(names),
        *([attribution_section(attribution)] if attribution is not None else []),
        *_factors(study, results),
        _everything(results, verdicts, links),
        data_section(out),
    ]
    cells, filters = len(results), len(names)
    subtitle = f"{cells} scenario{'s' * (cells > 1)} · {filters} filter{'s' * (filters > 1)} on identical measurements"
    return write_page(out / "report.html", title=f"Study: {study.name}", subtitle=subtitle, contents=contents)


# ---- first screen ---------------------------------------------------------------------------------------------------


_MATRIX_NOTE = (
    "Position RMSE, and pose NEES / 6 (1 is ideal) below it. Green: significantly the smallest error; red:"
    " significantly larger than the smallest, or diverged; plain: not significant. NEES: green in its band, red"
    " overconfident, brown too cautious. Links lead to the full report of each scenario."
)


def _sentences(verdicts: Mapping[str, Verdict], names: Sequence[str]) -> list[str]:
    """Headline: which filters are the best in how many scenarios, and why some have none."""
    if len(verdicts) == 1:
        return [next(iter(verdicts.values())).headline]
    by_leaders: dict[tuple[str, ...], list[Verdict]] = {}
    for verdict in verdicts.values():
        by_leaders.setdefault(tuple(name for name in names if name in verdict.leaders), []).append(verdict)
    unknown = by_leaders.pop((), [])
    if len(names) == 1:
        sentences = [sentence("one_filter", names[0], len(verdicts) - len(unknown), len(verdicts))]
    else:
        sentences = []
        for leaders, best in sorted(by_leaders.items(), key=lambda item: -len(item[1])):
            has_rivals, significant = len(leaders) < len(names), sum(verdict.is_shown for verdict in best)
            sentences.append(sentence("leaders", leaders, len(best), len(verdicts), has_rivals, significant))
    reasons = list(dict.fromkeys(verdict.headline for verdict in unknown))
    return sentences + ([sentence("no_leader", len(unknown), reasons, len(names) == 1)] if unknown else [])


def _matrix(
    results: Mapping[str, CellResult],
    verdicts: Mapping[str, Verdict],
    names: Sequence[str],
    links: Mapping[str, str],
) -> Table:
    """Scenarios down and filters across, or the other way round where there are more filters."""
    colours = filter_colours(names)
    by_filter = {(cell, s.filter_name): s for cell, outcome in results.items() for s in outcome.summaries}

    def entry(cell: str, name: str) -> TableCell:
        summary = by_filter.get((cell, name))
        return number(None) if summary is None else _entry(summary, verdicts[cell])

    if len(names) > len(results):
        columns = [Column("Filter", kind="text"), *(Column(cell, link=links[cell]) for cell in results)]
        rows = [[filter_cell(name, colours), *(entry(cell, name) for cell in results)] for name in names]
    else:
        columns = [Column("Scenario", kind="text"), *(Column(name) for name in names)]
        rows = [[TableCell(cell, link=links[cell]), *(entry(cell, name) for name in names)] for cell in results]
    return Table(columns, rows, latex="scenarios")


def _entry(summary: FilterSummary, verdict: Verdict) -> TableCell:
    if summary.position_rmse_m is None:
        innovations = number(summary.nis, ".2f").text
        return TableCell(lost(summary) if summary.diverged else f"NIS / dof: {innovations}", None)
    error = number(summary.position_rmse_m, ".3g", " m", _standing(summary, verdict))
    note = f"NEES / 6: {POSE_NEES.text(summary.pose_anees)}" if summary.pose_anees is not None else ""
    if summary.diverged:
        note = lost(summary)
    tone: Tone = "bad" if summary.diverged else TONES[consistency(summary)]
    return TableCell(error.text, error.key, error.tone, note=note, note_tone=tone)


def _standing(summary: FilterSummary, verdict: Verdict) -> Tone:
    if summary.filter_name in verdict.leaders:
        return "good" if verdict.is_shown else ""
    comparison = verdict.comparisons.get(summary.filter_name)
    return "bad" if comparison is not None and comparison.shown else ""


# ---- factors --------------------------------------------------------------------------------------------------------


def _factors(study: Study, results: Mapping[str, CellResult]) -> list[Section]:
    factors = list(dict.fromkeys(name for cell in study.cells for name in cell.factors))
    sections = []
    for i, factor in enumerate(factors):
        groups: dict[str, list[CellResult]] = {}
        levels: dict[str, Any] = {}
        for cell in study.cells:
            if cell.name in results and factor in cell.factors:
                text = _level(cell.factors[factor])
                groups.setdefault(text, []).append(results[cell.name])
                levels.setdefault(text, cell.factors[factor])
        if len(groups) < 2:
            continue
        numbers = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in levels.values())
        levels_shown = list(levels.values()) if numbers else list(levels)
        responses = _responses(list(groups.values()))
        if not responses:
            continue
        averaged = ", over seeds and the other factors" if len(factors) > 1 else ", over seeds"
        caption = f"Geometric means{averaged}, with 95 % intervals over seeds where there are at least {MIN_PAIRS}."
        figure = plot_factor("" if factor == "cell" else factor, levels_shown, responses)
        heading = "Side by side" if factor == "cell" else f"Effect of {factor}"
        sections.append(Section(heading, [Drawing(f"factor_{i}", caption, figure)]))
    return sections


def _level(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_level(inner)}" for key, inner in value.items())
    if isinstance(value, (list, tuple)):
        return " ".join(map(_level, value))
    return "none" if value is None else str(value)


def _responses(groups: Sequence[Sequence[CellResult]]) -> list[FactorResponse]:
    """Responses at each level; a group is the cells of a level."""
    seeds = max(len(s.position_rmse_by_run) for group in groups for outcome in group for s in outcome.summaries)
    low, high = mean_band(DOF["pose"], max(seeds, 1))
    band = low / DOF["pose"], high / DOF["pose"]
    kinds = (
        (f"{capital(POSITION.label)}, geometric mean ({POSITION.unit})", POSITION, True),
        (f"{capital(POSE_NEES.label)}, geometric mean, band of the mean in grey", POSE_NEES, True),
        (f"{capital(EFFICIENCY.label)}, geometric mean ({EFFICIENCY.unit})", EFFICIENCY, False),
    )
    names = list(dict.fromkeys(s.filter_name for group in groups for o in group for s in o.summaries))
    responses = []
    for title, measure, log in kinds:
        points = {
            name: np.array([_mean_and_interval([_by_seed(o, name, measure) for o in group]) for group in groups]).T
            for name in names
        }
        points = {name: curve for name, curve in points.items() if np.isfinite(curve[0]).any()}
        if points:
            means, lows, highs = ({name: curve[i] for name, curve in points.items()} for i in range(3))
            responses.append(FactorResponse(title, means, lows, highs, band if measure is POSE_NEES else None, log))
    return responses


def _mean_and_interval(cells: Sequence[Mapping[int | None, float]]) -> tuple[float, float, float]:
    """Geometric mean over seeds of the geometric mean over cells, and its interval over seeds."""
    seeds = sorted(set.intersection(*(set(values) for values in cells)), key=str)
    table_of = np.array([[values[seed] for values in cells] for seed in seeds]).reshape(len(seeds), len(cells))
    usable = (np.isfinite(table_of) & (table_of > 0)).all(axis=1)
    logs = np.log(table_of[usable]).mean(axis=1)
    mean = float(np.exp(logs.mean())) if len(logs) else float("nan")
    if len(logs) < MIN_PAIRS:
        return mean, float("nan"), float("nan")
    low, high = studentised_interval(logs[:, None], CONFIDENCE)
    return mean, float(np.exp(low[0])), float(np.exp(high[0]))


def _by_seed(outcome: CellResult, name: str, measure: Figure) -> dict[int | None, float]:
    """The values of a measure in the runs of a filter, as far as they are known."""
    of_run = outcome.figures[name].of_run if name in outcome.figures else {}
    values = {seed: measure.of(figures) for (_, seed), figures in of_run.items()}
    return {seed: value for seed, value in values.items() if np.isfinite(value)}


# ---- the long table -------------------------------------------------------------------------------------------------


def _everything(
    results: Mapping[str, CellResult], verdicts: Mapping[str, Verdict], links: Mapping[str, str]
) -> Section:
    summaries = [s for outcome in results.values() for s in outcome.summaries]
    figures = console_columns(summaries)
    columns = [
        Column("Scenario", kind="text"),
        Column("Filter", kind="text"),
        Column("Against the best", "run by run, %, 95 % interval", RUN_BY_RUN),
        *map(figure_column, figures),
    ]
    colours = filter_colours(s.filter_name for s in summaries)
    rows: list[list[TableCell]] = []
    for cell, outcome in results.items():
        for s in outcome.summaries:
            tones = {
                POSITION.name: _standing(s, verdicts[cell]),
                POSE_NEES.name: TONES[consistency(s)],
            }
            first = [
                TableCell(cell, link=links[cell]),
                filter_cell(s.filter_name, colours),
                _against_best(s, verdicts[cell]),
            ]
            rows.append([*first, *(figure_cell(figure, s, tones.get(figure.name, "")) for figure in figures)])
    return Section("All figures", [Table(columns, rows, "wide", latex="figures")])


def _against_best(summary: FilterSummary, verdict: Verdict) -> TableCell:
    if summary.filter_name == verdict.best:
        return TableCell("tie" if len(verdict.leaders) > 1 else "smallest", 0.0, "none")
    comparison = verdict.comparisons.get(summary.filter_name)
    if comparison is None or not comparison.difference.count:
        return number(None)
    if comparison.tied:
        return TableCell("tie", 0.0, "none")
    finding = comparison.difference.finding
    return percent_cell(
        comparison.difference, FINDING_TONES[finding if finding is Finding.WORSE else Finding.NOT_SHOWN]
    )


def write_report_of(directory: StudyDirectory, results: Sequence[CellResult]) -> Path:
    """Write the report of every cell, and of a grid the one over all of them; returns the page to open."""
    factorial = directory.study.factorial
    pages = [
        write_report(
            result.directory.out,
            f"Comparison: {result.cell.name}",
            result.runs,
            result.summaries,
            result.figures,
            _settings_of(result),
            bounds=result.bounds,
            attribution=None if factorial is None else attribution_of(factorial, result),
            looks=looks_of(result) if result.cell.scenario.policies else None,
            recordings=recordings_of(result),
            audits=result.directory.audits(),
        )
        for result in results
    ]
    if not directory.study.is_grid:
        return pages[0]
    return write_study_report(directory.out, directory.study, {result.cell.name: result for result in results})


def _settings_of(result: CellResult) -> dict[str, Any]:
    """What was asked for, and what was read of real recordings."""
    words = result.directory.recording_words()
    return result.directory.settings() | ({"recordings": words} if words else {})


def recordings_of(result: CellResult) -> dict[str, dict[str, Path]]:
    """Files of the recordings of a cell, by seed; where policies drive, one of each competitor."""
    directory, choices = result.directory, result.cell.scenario.competitors
    policies = [choice for choice in choices if choice.policy is not None]
    return {
        seed_name(seed): {f"recording of {choice.label}": directory.recording_path(seed, choice) for choice in policies}
        or {"recording": directory.recording_path(seed)}
        for seed in directory.seeds
    }


def looks_of(result: CellResult) -> Looks:
    """The baseline of the policies, and the gaze of all in the first seed; missing recordings are left out."""
    competitors, seed = result.cell.scenario.competitors, result.directory.seeds[0]
    paths = {choice.label: result.directory.recording_path(seed, choice) for choice in competitors}
    recordings = {label: load_recording(path) for label, path in paths.items() if path.exists()}
    return Looks(baseline_of(competitors), recordings)


def attribution_of(factorial: Mapping[str, Sequence[Any]], result: CellResult) -> Attribution | None:
    """Which option of the filter makes the difference in this cell; None where too little is left to tell."""
    try:
        return attribute_runs(factorial, result.figures)
    except ValueError as error:
        _log.warning("no attribution for %s: %s", result.cell.name, error)
        return None
