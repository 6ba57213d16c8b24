"""The page of `stereo-slam report A B`: what changed significantly from one run of the benchmark to another one."""

from __future__ import annotations

from pathlib import Path

from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.comparison import Change, RunComparison
from stereo_slam_env.benchmark.statistics.differences import signed
from stereo_slam_env.report.charts.factors import plot_changes
from stereo_slam_env.report.charts.style import filter_colours
from stereo_slam_env.report.page import FIGURES, figure_block, html_page, joined, part
from stereo_slam_env.report.page_tables import Cell, Column, filter_cell, number, table
from stereo_slam_env.report.tables import finding_tone


def write_comparison_report(out: Path, comparison: RunComparison) -> Path:
    """Write `out/comparison.html`, and its figure as `out/figures/changes.png` and `.svg`.

    Parameters
    ----------
    out : Path
        Directory; made if it is not there.
    comparison : RunComparison
        Of two runs.

    Returns
    -------
    Path
        The page.
    """
    folder = out / FIGURES
    body = [
        part("paragraph", comparison.headline, "headline"),
        part("items", comparison.warnings, "failures fair"),
        _table(comparison.changes),
        part("paragraph", _guide(comparison)),
    ]
    if any(change.interval_percent is not None for change in comparison.changes):
        caption = "Change of every measure with its 95 % interval; left of the line it became smaller."
        body.append(figure_block(plot_changes(comparison.changes), "changes", caption, folder))
    body.append(_only(comparison))
    out.mkdir(parents=True, exist_ok=True)
    path = out / "comparison.html"
    subtitle = f"Before: {comparison.before} · After: {comparison.after}"
    path.write_text(html_page(title="What changed", subtitle=subtitle, body=joined(body)), encoding="utf-8")
    return path


def _guide(comparison: RunComparison) -> str:
    pairing = "recording by recording, on the same measurements" if comparison.paired else "as two unpaired samples"
    return (
        f"Compared {pairing}. Green and red: interval and test both show the change; grey: no difference shown. Errors"
        " and times are geometric means over runs."
    )


def _table(changes: tuple[Change, ...]) -> Markup:
    columns = [
        Column("Filter", kind="text"),
        Column("Measure", kind="text"),
        Column("Before"),
        Column("After"),
        Column("Change", "%, 95 % interval"),
        Column("p", "corrected"),
        Column("Runs"),
        Column("Finding", kind="text"),
        Column("In words", kind="words"),
    ]
    colours = filter_colours(change.filter_name for change in changes)
    rows: list[list[Cell | str]] = []
    for change in changes:
        tone = finding_tone(change.finding)
        interval = change.interval_percent
        text = "–" if interval is None else " to ".join(dict.fromkeys(signed(end) for end in interval))
        rows.append(
            [
                filter_cell(change.filter_name, colours),
                f"{change.measure}, {change.unit}" if change.unit else change.measure,
                number(change.before, ".4g"),
                number(change.after, ".4g"),
                Cell(text, None if interval is None else 0.5 * sum(interval), tone),
                number(change.p_value, ".2g"),
                number(change.count, "d"),
                Cell(change.finding.value, tone=tone),
                Cell(change.words),
            ]
        )
    return table(columns, rows, wide=True)


def _only(comparison: RunComparison) -> Markup:
    """Filters and recordings that one of the runs has and the other one has not."""
    parts = (
        ("filters", "before", comparison.filters_before),
        ("filters", "after", comparison.filters_after),
        ("recordings", "before", comparison.recordings_before),
        ("recordings", "after", comparison.recordings_after),
    )
    lines = [f"Only {when}: {kind} {', '.join(names)}" for kind, when, names in parts if names]
    return part("section", "Not compared", "", [part("items", lines)]) if lines else Markup()
