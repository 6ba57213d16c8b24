"""Output of the command line: settings, the progress bar and the result table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from stereo_slam_env.benchmark.scenarios.recording_description import (
    LAGS,
    OUTLIER,
    MeasurementErrors,
    NoiseOfRange,
    error_correlation,
    noise_by_range,
    noise_remarks,
    recording_words,
)
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.statistics.changes import RunComparison
from stereo_slam_env.benchmark.statistics.policy_verdict import baseline_of, judge_policies
from stereo_slam_env.benchmark.statistics.remarks import (
    innovation_remarks,
    motion_remarks,
    reference_remarks,
)
from stereo_slam_env.benchmark.statistics.verdict import judge
from stereo_slam_env.benchmark.storage.result_tables import CellResult
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.report.table import Column, Table, show_table
from stereo_slam_env.report.tables import MOST_COLUMNS, summary_table

if TYPE_CHECKING:  # runs the front end
    from stereo_slam_env.benchmark.campaign import Progress as ProgressCallback


def show_settings(console: Console, scenario: Scenario) -> None:
    """Print what the filters will assume: nothing of it is hidden in the code."""
    sees = scenario.source.takes_images
    noise = "as each measurement says" if sees else "as the recording says"
    if scenario.noise is not None:
        noise = f"{json.dumps(dict(scenario.noise))} px"
    motion = scenario.motion
    lines = {
        "scenario": f"{scenario.name} ({scenario.source})",
        "frames": "all" if scenario.frames is None else str(scenario.frames),
        "assumed noise": noise,
        "gate": "none" if scenario.gate is None else f"{scenario.gate:g} per landmark",
        "consensus": "one-point RANSAC over the frame" if scenario.consensus else "no",
        "odometry": "used" if scenario.use_odometry else "not used",
        "motion": f"{motion['sigma_acceleration']:.3g} m/s², {motion['sigma_angular_acceleration']:.3g} rad/s²",
        "filters": _choices(scenario.filters),
    }
    if scenario.policies:
        lines["policies"] = _choices(scenario.policies)
    if sees:
        lines["search"] = {"flow": "the same for all filters", "forecast": "guided by each filter"}[scenario.search]
    if scenario.source.seeded:
        lines["seeds"] = _ranges(scenario.seeds)
    _show_lines(console, lines)


def _show_lines(console: Console, lines: Mapping[str, str]) -> None:
    for name, value in lines.items():
        console.print(f"[dim]{name:>14}[/dim]  {value}", highlight=False, soft_wrap=True)


def _choices(choices: Sequence[FilterChoice] | Sequence[PolicyChoice]) -> str:
    if len(choices) > MOST_COLUMNS:
        return f"{len(choices)}: {', '.join(choice.label for choice in choices)}"
    return ", ".join(
        choice.label + (f" {json.dumps(dict(choice.options))}" if choice.options else "") for choice in choices
    )


def show_study(console: Console, study: Study) -> None:
    """Print what is going to be run."""
    first, lines = study.cells[0], {}
    if study.factorial is not None:
        lines["crossed"] = "; ".join(f"{name}: {', '.join(map(str, of))}" for name, of in study.factorial.items())
    if study.is_grid:
        lines["study"] = f"{study.name}: {len(study.cells)} scenarios"
        for factor in first.factors:
            lines[factor] = ", ".join(dict.fromkeys(str(cell.factors.get(factor)) for cell in study.cells))
        lines[""] = "the first of them:"
    _show_lines(console, lines)
    show_settings(console, first.scenario)


def show_recording(console: Console, recording: Recording) -> None:
    """Print what a real recording holds and how it was read."""
    _show_lines(console, recording_words(recording))


def show_noise(console: Console, name: str, found: MeasurementErrors) -> None:
    """Print the errors of measurements, a block a range, a line a coordinate; then how they last, and remarks."""
    rows = noise_by_range(found)
    console.print(f"errors of the measurements of {escape(name)}, px", highlight=False)
    if not rows:
        console.print("none of them has a known truth")
    else:
        show_table(console, _noise_table(rows, claims=found.R is not None))
        if found.R is not None:
            console.print(_CLAIMS_READ, highlight=False)
        console.print("correlation of two errors of a landmark (u, v, d)", highlight=False)
        for lag in LAGS:
            correlations = ", ".join(_shown(value, "+.2f") for value in error_correlation(found, lag))
            console.print(f"  {'1 frame' if lag == 1 else f'{lag} frames'} apart: {correlations}", highlight=False)
    for remark in noise_remarks(found):
        console.print(f"[yellow]note[/yellow]: {remark}", highlight=False)


_CLAIMS_READ = (
    "over claim: errors over what is claimed of each; NEES: its median over that of χ²; 1 is ideal, more is too sure"
)


def _noise_table(rows: Sequence[NoiseOfRange], *, claims: bool) -> Table:
    """Table of three rows a range, one a coordinate."""
    claimed = ("claimed", "over claim", "NEES") if claims else ()
    cells = []
    for row in rows:
        depths = f"{row.low:g}–{row.high:g}" if math.isfinite(row.high) else f"over {row.low:g}"
        about = ("all" if row is rows[-1] else depths, str(row.count))
        for axis, coordinate in enumerate("uvd"):
            errors = [_shown(row.bias[axis], "+.3f"), _shown(row.sigma[axis], ".3f")]
            if claims:
                errors += [_shown(row.claimed[axis], ".3f"), _shown(row.over_claim[axis], ".2f")]
                errors.append(_shown(row.nees, ".2f") if axis == 0 else "")
            start = about if axis == 0 else ("", "")
            cells.append([*start, coordinate, *errors, _shown(row.outliers[axis], ".1%")])
    headings = ("count", "", "bias", "sigma", *claimed, f"beyond {OUTLIER:g} px")
    return Table([Column("depth", "m", kind="words"), *map(Column, headings)], cells, block=3)


def _shown(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)


@contextmanager
def progress_bar(console: Console, what: str = "trials") -> Iterator[ProgressCallback]:
    """A bar with the time left, to be used as `progress=`; `what` are counted."""
    columns = (
        TextColumn("running"),
        BarColumn(),
        TextColumn("{task.fields[count]}"),
        TextColumn("{task.fields[said]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    bar = Progress(*columns, console=console)
    task = bar.add_task("running", total=None, count="", said="")

    def tell(done: float, total: int, said: str = "") -> None:
        if not bar.live.is_started:  # not before there is something to tell: wrong input is refused before that
            bar.start()
        bar.update(task, completed=done, total=total, count=f"{math.floor(done)} of {total} {what}", said=said)

    try:
        yield tell
    finally:
        if bar.live.is_started:
            bar.stop()


def show_results(console: Console, summaries: Sequence[FilterSummary], *, claims: bool = False) -> None:
    """Print the result table, a line for each option a filter was not given and for each run that failed.

    A column a filter; of many filters, a row each, with the figures that matter most. `claims`: with what is claimed of
    the final pose.
    """
    show_table(console, summary_table(summaries, claims=claims))
    for summary in summaries:
        for remark in summary.remarks:
            console.print(f"[yellow]note[/yellow]: {escape(remark)}", highlight=False, soft_wrap=True)
        for failure in summary.failures:
            console.print(
                f"[red]{escape(summary.filter_name)} failed[/red]: {escape(failure)}", highlight=False, soft_wrap=True
            )


def show_cells(console: Console, results: Sequence[CellResult]) -> None:
    """Print the table of every cell."""
    for result in results:
        if result.cell.factors:
            console.print(f"\n[bold]{escape(result.cell.name)}[/bold]", highlight=False)
        show_results(console, result.summaries, claims=bool(result.cell.scenario.policies))
        about = *innovation_remarks(result.summaries), *motion_remarks(result.runs, result.summaries)
        words = [_headline(result), *reference_remarks(result.runs).values(), *about]
        console.print("\n" + escape("\n".join(words)) + "\n", highlight=False, soft_wrap=True)


def _headline(result: CellResult) -> str:
    scenario = result.cell.scenario
    if not scenario.policies:
        return "\n".join(judge(result.summaries, result.figures).lines)
    verdict = judge_policies(result.summaries, result.figures, baseline=baseline_of(scenario.competitors))
    return "\n".join([verdict.headline, *(f"- {comparison.words}" for comparison in verdict.comparisons.values())])


def show_comparison(console: Console, comparison: RunComparison) -> None:
    """Print what changed between two runs, what did not, and what to bear in mind; it fits a screen."""
    console.print(escape(comparison.headline), highlight=False, soft_wrap=True)
    for warning in comparison.warnings:
        console.print(f"[yellow]note[/yellow]: {escape(warning)}", highlight=False, soft_wrap=True)
    if comparison.shown:
        columns = [Column(of, kind="number" if of in ("before", "after") else "words") for of in comparison.columns]
        show_table(console, Table(columns, comparison.as_rows()))
    for line in comparison.rest:
        console.print(escape(line), highlight=False, soft_wrap=True)


def _ranges(seeds: Sequence[int]) -> str:
    consecutive = list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    return f"{seeds[0]} to {seeds[-1]}" if consecutive and len(seeds) > 1 else ", ".join(map(str, seeds))
