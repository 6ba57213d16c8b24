"""A figure of a run has one value and one name, wherever it is printed (15 s)."""

import csv
import io
import json
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from markupsafe import Markup
from rich.console import Console

from stereo_slam_env.benchmark import FilterChoice, Scenario, compare, judge, run_benchmark
from stereo_slam_env.benchmark.head_to_head import Bench
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.statistics.measures import EFFICIENCY, MEASURES
from stereo_slam_env.evaluation.figures import FIGURES
from stereo_slam_env.report import page as page_module
from stereo_slam_env.report.benchmark_report import write_report_of
from stereo_slam_env.report.comparison_report import write_comparison_report
from stereo_slam_env.report.console import show_comparison, show_results
from stereo_slam_env.report.overview import overview

from ...synthetic_runs import Behaviour, make_runs, scored

SCENARIO = Scenario(
    "tiny",
    ReferenceSource("short_turn", {"landmarks": 12}),
    filters=(FilterChoice("ours", "inverse-depth"), FilterChoice("theirs", "euclidean")),
    seeds=(0, 1, 2),
    frames=6,
    gate=None,
)


class Tables(HTMLParser):
    """The tables of a page: rows of the texts of their cells, heading and unit of each column in the first."""

    def __init__(self, markup):
        super().__init__()
        self.tables = []
        self.feed(markup)

    def handle_starttag(self, tag, attrs):
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("th", "td"):
            self.tables[-1][-1].append([])

    def handle_data(self, data):
        if self.tables and self.tables[-1] and self.tables[-1][-1] and data.strip():
            self.tables[-1][-1][-1].append(data.strip())


def on_console(show, *arguments, width=160):
    console = Console(file=io.StringIO(), width=width)
    show(console, *arguments)
    return console.file.getvalue()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run_benchmark(SCENARIO, tmp_path_factory.mktemp("one") / "run", jobs=1, write_report=write_report_of)


@pytest.mark.parametrize("figure", [m for m in MEASURES if m is not EFFICIENCY], ids=lambda figure: figure.name)
def test_the_value_is_the_same_wherever_it_is_printed(finished, figure):
    summaries = {summary.filter_name: summary for summary in finished.summaries}
    said = {name: figure.text(summary.figures[figure.name]) for name, summary in summaries.items()}
    if set(said.values()) == {"–"}:
        pytest.skip(f"no {figure.label} here")

    stored = json.loads((finished.out / "summary.json").read_text())["filters"]
    assert {name: figure.text(row[figure.name]) for name, row in stored.items()} == said
    with (finished.out / "summary.csv").open() as stream:
        rows = {row["filter"]: float(row[figure.column]) for row in csv.DictReader(stream)}
    assert {name: figure.text_of(value) for name, value in rows.items()} == said

    if "console" in figure.places:
        (line,) = re.findall(rf"^{re.escape(figure.title)}.*$", on_console(show_results, finished.summaries), re.M)
        assert line.split()[-2:] == list(said.values())

    comparison = compare(finished, finished)
    changes = {c.filter_name: c for c in comparison.changes if c.measure == figure.label}
    assert {name: change.values for name, change in changes.items()} == {n: (v, v) for n, v in said.items()}

    label = figure.label[0].upper() + figure.label[1:]
    found = {}
    for head, *rows in Tables(finished.report.read_text(encoding="utf-8")).tables:
        for column, heading in enumerate(head):
            if heading[0] == label and head[0][0] == "Filter" and head[1][0] != "against":
                found = {row[0][0]: row[column][0].replace("−", "-") for row in rows}
    assert found == said


def test_the_trial_table_combines_to_the_summary(finished):
    with closing(sqlite3.connect(finished.out / "trials.sqlite")) as database:
        rows = database.execute("SELECT filter, position_rmse_m, pose_anees_per_dof FROM trials").fetchall()
    for summary in finished.summaries:
        errors, nees = np.array([row[1:] for row in rows if row[0] == summary.filter_name]).T
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(summary.position_rmse_m)
        assert nees.mean() == pytest.approx(summary.pose_anees / 6)  # runs of the same length


def uneven(factor=10.0):
    """Two filters, one hard recording: the ratio of the root mean squares is not the mean of the ratios."""
    runs = make_runs((Behaviour("ours", 0.1), Behaviour("theirs", 0.1)), range(8), 40)
    base = {run.seed: run for run in runs if run.filter_name == "ours"}

    def scaled(run):
        own = base[run.seed]
        error = (own.true_positions - own.positions) * (factor if run.seed == 0 else 1.2 + 0.03 * run.seed)
        return replace(own, filter_name="theirs", positions=own.true_positions - error)

    return [run if run.filter_name == "ours" else scaled(run) for run in runs]


def test_a_relative_difference_beside_two_values_says_what_it_is_of():
    """Of one run it is the ratio of both; of many it is run by run, and the head of the column says so."""
    summaries, figures = scored(uneven())
    ours, theirs = (summary.position_rmse_m for summary in summaries)
    difference = judge(summaries, figures).comparisons["theirs"].difference
    assert abs(100 * (theirs / ours - 1) - difference.percent) > 50  # so it must be said
    head, *_ = Tables(str(overview(summaries, judge(summaries, figures)))).tables[0]
    assert "error against ours run by run, 95 % interval" in head[2]

    one = [run for run in uneven() if run.seed == 0]
    summaries, figures = scored(one)
    head, *rows = Tables(str(overview(summaries, judge(summaries, figures)))).tables[0]
    ours, theirs = (float(row[1][0].removesuffix(" m")) for row in rows)
    said = float(rows[1][2][0].removesuffix(" %").replace("+", "").replace(",", ""))
    assert said == pytest.approx(100 * (theirs / ours - 1), abs=6)  # of values with three digits


def test_every_comparison_of_values_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "figure_blocks", lambda drawings, _: {one.name: Markup() for one in drawings})
    runs = uneven(1.6)
    before = [run for run in runs if run.filter_name == "ours"]
    after = [replace(run, filter_name="ours") for run in runs if run.filter_name == "theirs"]
    comparison = compare(*(SimpleNamespace(runs=side, figures=scored(side)[1]) for side in (before, after)))
    (change,) = (c for c in comparison.shown if c.measure == "position error")
    summary = scored(before)[0][0]
    assert change.before == summary.position_rmse_m
    assert change.values[0] == FIGURES["position_rmse_m"].text(summary.position_rmse_m)
    assert "change run by run" in on_console(show_comparison, comparison)
    assert comparison.headline.startswith("Worse after than before, run by run: position error of ours: ")
    page = write_comparison_report(tmp_path, comparison).read_text(encoding="utf-8")
    assert "Change<small>run by run, 95 % interval</small>" in page


def test_a_comparison_in_code_says_so_too():
    result = Bench(seeds=2)("euclidean", against="inverse-depth", scenario=SCENARIO)
    assert "run by run euclidean is" in str(result).splitlines()[1]
    for side in (result.summary, result.reference):
        assert FIGURES["position_rmse_m"].text(side.position_rmse_m) in str(result)


# ---- a comparison fits a screen --------------------------------------------------------------------------------------


def filters_of(count, factor, seeds):
    names = [f"filter-{number:02d}" for number in range(count)]
    runs = make_runs([Behaviour(name, 0.1) for name in names], range(seeds), 30)
    worse = [
        replace(run, positions=run.true_positions + factor(run) * (run.positions - run.true_positions)) for run in runs
    ]
    sides = (SimpleNamespace(runs=side, figures=scored(side)[1]) for side in (runs, worse))
    return compare(*sides)


def test_what_is_not_shown_is_a_line():
    said = on_console(show_comparison, filters_of(40, lambda run: 1.0 + 0.01 * run.seed, 3), width=100)
    assert len(said.splitlines()) <= 6
    assert "filter-00, filter-01, filter-02 and 37 more: not significant: 3 runs are too few, " in said
    assert "to +" not in said  # no interval where no outcome could count


def test_many_shown_changes_are_cut_to_a_screen_and_counted():
    comparison = filters_of(40, lambda run: 3.0 + 0.01 * run.seed, 16)
    assert len(comparison.shown) == 80  # position error and rigid ATE of each
    said = on_console(show_comparison, comparison, width=100)
    assert len(said.splitlines()) <= 40
    assert "56 more changes are shown; the page has them all." in said
    assert "position error" in said


def test_where_no_outcome_could_count_there_is_no_interval_anywhere(tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "figure_blocks", lambda drawings, _: {one.name: Markup() for one in drawings})
    comparison = filters_of(2, lambda run: 1.1 + 0.01 * run.seed, 6)  # 6 runs would do for one comparison
    assert all(change.interval_percent is None for change in comparison.changes if not change.difference.tied)
    page = write_comparison_report(tmp_path, comparison).read_text(encoding="utf-8")
    assert not re.search(r"[+−]\d+ to [+−]\d+", page)
    assert "6 runs are too few" in page
