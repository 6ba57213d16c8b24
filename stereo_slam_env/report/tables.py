"""Tables of a report: every figure of every filter, by the table of figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereo_slam_env.benchmark.statistics.differences import Difference, Finding, signed
from stereo_slam_env.benchmark.statistics.measures import EFFICIENCY, POSE_NEES, PairwiseTable, pose_nees
from stereo_slam_env.benchmark.statistics.remarks import limit_reached
from stereo_slam_env.evaluation.figures import FIGURES, Figure, Group
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.charts.axes import filter_colours
from stereo_slam_env.report.table import Column, Table, TableCell, Tone, filter_cell, known, number

MOST_COLUMNS = 5
"""Of more filters than that, each has a row instead of a column on the screen."""
_CLAIMS_MATTER_MOST = (
    *("final_position_sigma_m", "final_pose_logdet", "end_error_m", "position_rmse_m", "pose_anees", "diverged"),
)


def summary_table(summaries: Sequence[FilterSummary], *, claims: bool = False) -> Table:
    """Figures on the screen: a column a filter; of many filters, a row each, with the figures that matter most.

    Figures that no filter has, and counts of nothing, are left out. `claims`: with what is claimed of the final pose.
    """
    brief = len(summaries) > MOST_COLUMNS
    figures = [f for f in FIGURES.values() if "console" in f.places and (claims or f.group != "claim")]
    figures.sort(key=lambda figure: figure.group != "claim")
    if brief:
        figures = [f for f in figures if (f.name in _CLAIMS_MATTER_MOST if claims else "brief" in f.places)]
    figures = [f for f in figures if _is_known(f, summaries)]
    figures = [f for f in figures if brief or not all(_counts_nothing(f, s) for s in summaries)]
    rows = {}
    for figure in figures:
        rows[_title(figure, summaries)] = [_screen_cell(figure, s) for s in summaries]
        if figure is EFFICIENCY and not brief:
            limits = map(limit_reached, summaries)
            rows["95 % interval of that"] = [number(None) if of is None else TableCell(of.sureness) for of in limits]
    by_figure: list[list[TableCell | str]] = [[title, *cells] for title, cells in rows.items()]
    names = [summary.filter_name for summary in summaries]
    if not brief:
        return Table([Column(""), *map(Column, names)], by_figure)
    by_filter: list[list[TableCell | str]] = [
        [name, *cells] for name, *cells in zip(names, *rows.values(), strict=True)
    ]
    return Table([Column(""), *map(Column, rows)], by_filter)


def _screen_cell(figure: Figure, summary: FilterSummary) -> TableCell:
    limit = limit_reached(summary) if figure is EFFICIENCY else None
    return figure_cell(figure, summary) if limit is None else TableCell(limit.value.removesuffix(" %"))


def _title(figure: Figure, summaries: Sequence[FilterSummary]) -> str:
    bands = {pose_nees(s)[1] for s in summaries if s.pose_anees_band is not None}
    of_all = f" (95 %: {next(iter(bands))})" if figure is POSE_NEES and len(bands) == 1 else ""
    return f"{figure.title}{of_all}"


def _counts_nothing(figure: Figure, summary: FilterSummary) -> bool:
    """Whether a count says nothing: no event, or all runs timed."""
    usual = summary.runs if figure.name == "timed" else 0
    counts = figure.per_runs or figure.kind == "integer" or figure.group == "events"
    return counts and summary.figures.get(figure.name) == usual


def figures_table(
    summaries: Sequence[FilterSummary], groups: Sequence[Group], who: str = "Filter", latex: str = ""
) -> Table:
    """Figures of these groups, a row a filter, which is called `who`."""
    figures = _shown(summaries, groups)
    cells = [[figure_cell(figure, s) for figure in figures] for s in summaries]
    return _rows(summaries, who, [figure_column(figure) for figure in figures], cells, latex)


def consistency_table(summaries: Sequence[FilterSummary], who: str = "Filter", latex: str = "") -> Table:
    """Mean NEES and NIS in their bands, and the share of the frames inside theirs."""
    figures = _shown(summaries, ("consistency",))
    columns, cells = [], []
    for figure in figures:
        if figure.ideal is None:  # a count
            columns.append(figure_column(figure))
            cells.append([figure_cell(figure, s) for s in summaries])
            continue
        figures_found = [s.consistency.get(figure.name.removesuffix("_anees")) for s in summaries]
        ideal = figure.ideal
        bands = {_band_words(f.band[0] / ideal, f.band[1] / ideal) for f in figures_found if f is not None}
        columns.append(_column(figure, "ideal 1" + (f", {next(iter(bands))}" if len(bands) == 1 else "")))
        tones: list[Tone] = [
            "" if f is None else "bad" if f.mean > f.band[1] else "fair" if f.mean < f.band[0] else "good"
            for f in figures_found
        ]
        cells.append([figure_cell(figure, s, tone) for s, tone in zip(summaries, tones, strict=True)])
        if bands:
            columns.append(
                Column("inside", "% frames", f"{figure.heading}: mean over runs inside the band of its frame")
            )
            cells.append([number(f.inside_percent if f else None, ".0f") for f in figures_found])
    return _rows(summaries, who, columns, list(zip(*cells, strict=True)) or [[]] * len(summaries), latex)


def _band_words(low: float, high: float) -> str:
    """Ends of a band, with as many digits as tell them apart from 1."""
    digits = next((n for n in (2, 3, 4) if round(low, n) < 1.0 < round(high, n)), 2)
    return f"{low:.{digits}f}–{high:.{digits}f}"


def pair_table(compared: PairwiseTable, who: str = "Filter", latex: str = "") -> Table:
    """A row for each pair of filters, a column for each question."""
    columns = [Column(who, kind="text"), Column("against", kind="text")]
    for measure in compared.measures:
        unit = "nearness to 1" if measure.ideal is not None else "run by run, %" if measure.is_ratio else "difference"
        columns.append(Column(capital(measure.label), unit))
    colours = filter_colours(compared.filters)
    pairs = list(dict.fromkeys((a, b) for _, a, b in compared.cells))
    order = {name: i for i, name in enumerate(compared.filters)}
    rows = []
    for a, b in pairs:
        if (b, a) in pairs and order[a] > order[b]:
            continue
        pair_cells = (pair_cell(measure, compared.cell(measure, a, b)) for measure in compared.measures)
        rows.append([filter_cell(a, colours), filter_cell(b, colours), *pair_cells])
    return Table(columns, rows, "wide", latex=latex)


FINDING_TONES: dict[Finding, Tone] = {Finding.BETTER: "good", Finding.WORSE: "bad", Finding.NOT_SHOWN: "none"}

"""Colour of each finding."""


def pair_cell(measure: Figure, difference: Difference | None) -> TableCell:
    """Difference and interval; of consistency, which is nearer to its ideal."""
    if difference is None:
        return number(None)
    tone = FINDING_TONES[difference.finding]
    if difference.tied:
        return TableCell("tie", difference.estimate, tone)
    if measure.ideal is not None:
        nearer = {Finding.BETTER: "nearer", Finding.WORSE: "farther"}.get(difference.finding, Finding.NOT_SHOWN.value)
        return TableCell(nearer, difference.estimate, tone)
    if not measure.is_ratio:
        interval = f" ({difference.interval_words})" if difference.interval is not None else ""
        return TableCell(f"{signed(difference.estimate, 2)}{interval}", difference.estimate, tone)
    return percent_cell(difference, tone)


def percent_cell(difference: Difference, tone: Tone) -> TableCell:
    """A change in %, with its interval in brackets where there is one."""
    text, interval = signed(difference.percent), difference.interval_percent
    if interval is not None:
        text += f" ({' to '.join(signed(end) for end in interval)})"
    return TableCell(text, difference.percent, tone)


def capital(words: str) -> str:
    """With a capital at the start, and the rest as it is: "Pose NEES"."""
    return words[:1].upper() + words[1:]


def console_columns(summaries: Sequence[FilterSummary]) -> list[Figure]:
    """Figures that the console shows, too, as far as any of the filters has them: those that matter most."""
    return [f for f in FIGURES.values() if "console" in f.places and f.group != "claim" and _is_known(f, summaries)]


def figure_column(figure: Figure) -> Column:
    """Heading of a figure."""
    unit = "95 % interval" if figure is EFFICIENCY else figure.unit
    return _column(figure, "ideal 1" if figure.ideal is not None else unit)


def figure_cell(figure: Figure, summary: FilterSummary, tone: Tone = "") -> TableCell:
    """Value of a figure."""
    value = summary.figures.get(figure.name)
    if figure is EFFICIENCY:
        limit = limit_reached(summary)
        return number(None) if limit is None else TableCell(limit.words, limit.percent)
    if figure.per_runs:
        return TableCell(f"{value} of {summary.runs}", value, "bad" if value and figure.group == "events" else "")
    return TableCell(figure.text(value).replace("-", "−"), known(figure.shown(value)), tone)


def _column(figure: Figure, unit: str) -> Column:
    over_runs = f"; over runs: {figure.over_runs.words}" if figure.over_runs else ""
    heading = figure.label if "_" in figure.label else capital(figure.label)  # t_rel is a symbol
    return Column(heading, unit, f"{figure.meaning}{over_runs}")


def _is_known(figure: Figure, summaries: Sequence[FilterSummary]) -> bool:
    return any(np.isfinite(figure.shown(s.figures.get(figure.name))) for s in summaries)


def _shown(summaries: Sequence[FilterSummary], groups: Sequence[Group]) -> list[Figure]:
    """Figures of these groups that reports show and that any of the filters has."""
    return [f for f in FIGURES.values() if f.group in groups and "report" in f.places and _is_known(f, summaries)]


def _rows(
    summaries: Sequence[FilterSummary],
    who: str,
    columns: Sequence[Column],
    cells: Sequence[Sequence[TableCell]],
    latex: str,
) -> Table:
    """Table with a row a filter."""
    colours = filter_colours(s.filter_name for s in summaries)
    rows = [[filter_cell(s.filter_name, colours), *row] for s, row in zip(summaries, cells, strict=True)]
    return Table([Column(who, kind="text"), *columns], rows, "wide", latex=latex)
