"""Reports of differences: between two runs, and between the options of a filter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from stereo_slam_env.benchmark.statistics.attribution import Attribution
from stereo_slam_env.benchmark.statistics.changes import Change, RunComparison
from stereo_slam_env.benchmark.statistics.differences import Finding
from stereo_slam_env.benchmark.statistics.effects import Contrast, ResponseAttribution
from stereo_slam_env.benchmark.statistics.sentences import few, sentence
from stereo_slam_env.evaluation.figures import UNKNOWN
from stereo_slam_env.report.charts.axes import filter_colours
from stereo_slam_env.report.charts.factors import plot_changes, plot_effects
from stereo_slam_env.report.overview import RUN_BY_RUN
from stereo_slam_env.report.page import Block, Content, Drawing, Section, part, write_page
from stereo_slam_env.report.table import Column, Table, TableCell, Tone, filter_cell, known, number
from stereo_slam_env.report.tables import FINDING_TONES, capital, percent_cell


def write_comparison_report(out: Path, comparison: RunComparison) -> Path:
    """Write `out/comparison.html`, and its figure as `out/figures/changes.png` and `.svg`; returns the page."""
    contents: list[Content] = [
        part("paragraph", comparison.headline, "headline"),
        part("items", comparison.warnings, "failures fair"),
    ]
    if comparison.shown:
        contents.append(
            Section("Shown", [_table(comparison.shown, comparison.how, "changes")], guide=_guide(comparison))
        )
    if comparison.rest:
        every = Block(
            f"All {len(comparison.changes)} comparisons", _table(comparison.changes, comparison.how), folded=True
        )
        lines = part("items", comparison.rest, "quiet")
        contents.append(Section("Not shown", [lines, every], "" if comparison.shown else _guide(comparison)))
    if drawn := _drawn(comparison.changes):
        caption = (
            f"Change of every measure{'' if len(drawn) == len(comparison.changes) else ' with an interval'}, "
            f"{comparison.how}, with its 95 % interval; left of the line it became smaller."
        )
        contents.append(Section("Intervals", [Drawing("changes", caption, plot_changes(drawn))]))
    contents.append(_only(comparison))
    subtitle = f"Before: {comparison.before} · After: {comparison.after}"
    return write_page(out / "comparison.html", title="What changed", subtitle=subtitle, contents=contents)


_MOST_DRAWN = 60


def _drawn(changes: Sequence[Change]) -> list[Change]:
    """Changes with an interval; of very many those that are shown."""
    drawable = [change for change in changes if change.interval_percent is not None]
    significant = [change for change in drawable if change.finding is not Finding.NOT_SHOWN]
    return drawable if len(drawable) <= _MOST_DRAWN else significant[:_MOST_DRAWN]


def _guide(comparison: RunComparison) -> str:
    pairing = "recording by recording, on the same measurements" if comparison.paired else "as two unpaired samples"
    common = ", over the recordings that both have" if comparison.paired else ""
    return (
        f"Compared {pairing}. Green and red: interval and test both show the change; grey: not significant. Before"
        f" and after are the figures of the reports{common}; the change is the geometric mean of ratios,"
        f" {comparison.how}, and not the ratio of the two, which one hard recording may decide."
    )


def _table(changes: Sequence[Change], how: str, latex: str = "") -> Table:
    columns = [
        Column("Filter", kind="text"),
        Column("Measure", kind="text"),
        Column("Before", "over runs"),
        Column("After", "over runs"),
        Column("Change", f"{how}, 95 % interval", RUN_BY_RUN),
        Column("p", "corrected"),
        Column("Runs"),
        Column("Finding", kind="text"),
    ]
    colours = filter_colours(change.filter_name for change in changes)
    rows: list[list[TableCell | str]] = []
    for change in changes:
        tone = FINDING_TONES[change.finding]
        interval, (before, after) = change.interval_percent, change.values
        sorted_by = None if interval is None else 0.5 * sum(interval)
        short = sentence("runs_too_few", change.difference.count, change.difference.needed)
        finding = "the same" if change.difference.tied else short if change.difference.too_few else change.finding.value
        rows.append(
            [
                filter_cell(change.filter_name, colours),
                change.title,
                TableCell(before, known(change.before)),
                TableCell(after, known(change.after)),
                TableCell(change.brief or UNKNOWN, sorted_by, tone),
                number(change.difference.p_value, ".2g"),
                number(change.difference.count, "d"),
                TableCell(finding, tone=tone),
            ]
        )
    return Table(columns, rows, "wide", latex=latex)


def _only(comparison: RunComparison) -> Section:
    """Filters and recordings that one of the runs has and the other one has not."""
    parts = (
        ("filters", "before", comparison.filters_before),
        ("filters", "after", comparison.filters_after),
        ("recordings", "before", comparison.recordings_before),
        ("recordings", "after", comparison.recordings_after),
    )
    lines = [f"Only {when}: {kind} {few(names)}" for kind, when, names in parts if names]
    return Section("Not compared", [part("items", lines)])


def conclusions(attribution: Attribution) -> Markup:
    """Conclusions: a line for each response."""
    return part("items", [response.conclusion for response in attribution.responses], "headline")


def attribution_section(attribution: Attribution) -> Section:
    """A drawing of the main effects, and tables."""
    caption = (
        "Main effects: how many times the average over all combinations a response is with that choice, with intervals"
        " corrected for their number. Blue: an effect is shown."
    )
    seeds = "1 seed" if attribution.seeds == 1 else f"{attribution.seeds} seeds"
    crossed = f"{attribution.combinations} combinations of options, {seeds}, each on the same measurements."
    contents: list[Content] = [
        Drawing("effects", caption, plot_effects(attribution)),
        Block("Instead of the first choice", _contrasts(attribution.responses)),
        Block("Share of the differences explained", _shares(attribution.responses)),
    ]
    if any(response.interactions for response in attribution.responses):
        count = sum(effect.difference.shown for response in attribution.responses for effect in response.interactions)
        total = sum(len(response.interactions) for response in attribution.responses)
        words = f"Interactions of two options: {count} of {total} shown"
        contents.append(Block(words, _interactions(attribution.responses), folded=True))
    if any(attribution.diverged_percent.values()):
        rows: list[list[TableCell | str]] = [
            [factor, str(level), number(percent, ".0f", tone="bad" if percent else "")]
            for (factor, level), percent in attribution.diverged_percent.items()
        ]
        columns = [Column("Option", kind="text"), Column("Level", kind="text"), Column("Diverged", "% of runs")]
        contents.append(Block("Divergence", Table(columns, rows)))
    if attribution.notes:
        contents.append(Block("Left out", part("items", attribution.notes)))
    return Section("Which choice makes the difference?", contents, crossed)


def _contrasts(responses: Sequence[ResponseAttribution]) -> Table:
    columns = [
        Column("Option", kind="text"),
        Column("Choice", kind="text"),
        Column("instead of", kind="text"),
        *(Column(capital(response.response), "change run by run, %", RUN_BY_RUN) for response in responses),
    ]
    found: dict[tuple[str, Any], dict[str, Contrast]] = {}
    for response in responses:
        for contrast in response.contrasts:
            found.setdefault((contrast.factor, contrast.level), {})[response.response] = contrast
    rows: list[list[TableCell | str]] = []
    for (factor, level), contrasts in found.items():
        reference = next(iter(contrasts.values())).instead_of
        row: list[TableCell | str] = [factor, str(level), str(reference)]
        for response in responses:
            row.append(_contrast_cell(contrasts.get(response.response)))
        rows.append(row)
    return Table(columns, rows)


def _contrast_cell(contrast: Contrast | None) -> TableCell:
    if contrast is None:
        return number(None)
    return percent_cell(contrast.difference, FINDING_TONES[contrast.finding])


def _interactions(responses: Sequence[ResponseAttribution]) -> Table:
    columns = [
        Column("Response", kind="text"),
        Column("Options", kind="text"),
        Column("Levels", kind="text"),
        Column("Together", "beyond each alone, %"),
        Column("Shown", kind="text"),
    ]
    rows: list[list[TableCell | str]] = []
    for response in responses:
        for effect in sorted(response.interactions, key=lambda e: (not e.difference.shown, -abs(e.difference.percent))):
            is_shown = effect.difference.shown
            tone: Tone = "" if is_shown else "none"
            rows.append(
                [
                    response.response,
                    " × ".join(effect.factors),
                    ", ".join(map(str, effect.levels)),
                    percent_cell(effect.difference, tone),
                    TableCell("yes" if is_shown else "no", tone=tone),
                ]
            )
    return Table(columns, rows)


def _shares(responses: Sequence[ResponseAttribution]) -> Table:
    keys = list(dict.fromkeys(names for response in responses for names in response.shares))
    columns = [
        Column("Options", kind="text"),
        *(Column(capital(r.response), "% of the variance") for r in responses),
    ]
    rows: list[list[TableCell | str]] = []
    for key in keys:
        rows.append([" × ".join(key) or "the rest", *(number(r.shares.get(key), ".1f") for r in responses)])
    return Table(columns, rows)
