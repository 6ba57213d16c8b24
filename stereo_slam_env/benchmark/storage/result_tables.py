"""Results of a study and their tables on disk: summaries as JSON and CSV, and all trials as SQLite.

CSV and SQLite have the units of the tables on the screen: a NEES is by its degrees of freedom, and its column says so.

The trial table is in docs/benchmark.md ("The run directory"); its table `columns` says what each column is. NULL is
what does not apply or is not finite.
"""

from __future__ import annotations

import csv
import io
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.scenarios.study import Cell
from stereo_slam_env.benchmark.storage.run_files import WRITTEN, Given, descriptions, write_trajectories
from stereo_slam_env.benchmark.storage.store import VERSION, RunDirectory, StudyDirectory
from stereo_slam_env.evaluation.figures import FIGURES, trial_columns
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, Figures, RunFigures, key_of, summarise, together
from stereo_slam_env.files.folders import unfinished_name, write_atomically, write_json

SCHEMA = 4
POSE_NEES = FIGURES["pose_anees"]
_TYPES = {"text": "TEXT", "integer": "INTEGER", "real": "REAL", "any": ""}


@dataclass(frozen=True, eq=False)
class CellResult:
    """Results of one cell."""

    directory: RunDirectory
    runs: tuple[FilterRun, ...]  # of the recordings that are kept, by seed, then filter
    recordings: tuple[Mapping[str, Any], ...]  # description of each recording, JSON-able, as in `summary.json`
    figures: Figures  # figures of every run, by label of the filter
    summaries: tuple[FilterSummary, ...]
    bounds: Bounds  # Cramer-Rao bounds of the recordings that are kept, where there are any

    @property
    def cell(self) -> Cell:
        """Scenario that was run."""
        return self.directory.cell

    @property
    def rows(self) -> dict[str, dict[str, Any]]:
        """Summaries by label of the filter, as in `summary.json`."""
        return {summary.filter_name: summary.as_dict() for summary in self.summaries}


def results_of(directory: RunDirectory) -> CellResult:
    """Results of the finished trials; raises as `RunDirectory.trials`."""
    given: Given = {}
    figures: dict[str, RunFigures] = {}
    summaries = []
    runs_kept: list[list[FilterRun]] = []
    for choice in directory.scenario.competitors:  # of many runs no more than those of one filter are in memory
        stored = list(directory.trials(choice, given))
        runs = [each.run for each in stored]
        scores = {key_of(each.run): each.score for each in stored if each.score is not None}
        figures[choice.label] = together(scores)
        summaries.append(summarise(runs, figures[choice.label]))
        runs_kept.append([run for run, seed in zip(runs, directory.seeds, strict=True) if directory.keeps(seed)])
    drawn = tuple(run for of_seed in zip(*runs_kept, strict=True) for run in of_seed)
    described = tuple(descriptions(directory.out, given))
    return CellResult(directory, drawn, described, figures, tuple(summaries), directory.bounds())


def write_results(study: StudyDirectory) -> list[CellResult]:
    """Write tables and trajectories from the finished trials, and return what they say; raises as `results_of`."""
    results = [_write_cell(directory) for directory in study.cells]
    if study.study.is_grid:
        cells = {result.cell.name: {"factors": dict(result.cell.factors), "filters": result.rows} for result in results}
        write_json(study.out / "summary.json", {"version": VERSION, "study": study.study.name, "cells": cells})
    write_trial_table(study.out / "trials.sqlite", results)
    return results


def _write_cell(directory: RunDirectory) -> CellResult:
    """Write `summary.json`, `summary.csv` and trajectories of the first recordings."""
    results, scenario = results_of(directory), directory.scenario
    about = {"version": VERSION, "scenario": scenario.name, "recordings": results.recordings}
    write_json(directory.out / "summary.json", {**about, "filters": results.rows})
    write_csv(directory.out / "summary.csv", results.summaries)
    write_trajectories(directory.out, scenario, results.runs[: WRITTEN * len(scenario.competitors)])
    return results


def write_csv(path: Path, summaries: Sequence[FilterSummary]) -> None:
    """Write summaries, one row for each filter and one plain value in each cell; what does not apply is empty.

    Columns are those of the trial table as far as they have a value over runs, in the same units, then the band of the
    pose NEES and the options, one column each. What is a list of its own is in `summary.json`.
    """
    rows = [_summary_row(summary) for summary in summaries]
    text = io.StringIO()
    table = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))


def _summary_row(summary: FilterSummary) -> dict[str, Any]:
    low, high = summary.pose_anees_band or (None, None)
    band = {f"{POSE_NEES.column}_{end}": POSE_NEES.in_unit(value) for end, value in (("low", low), ("high", high))}
    return {
        "filter": summary.filter_name,
        "runs": summary.runs,
        "failed": len(summary.failures),
        **{FIGURES[name].column: FIGURES[name].in_unit(value) for name, value in summary.figures.items()},
        **band,
        **dict(_flat("option", summary.options)),
    }


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Plain values of nested options with dots in their names: "option.motion.sigma_acceleration"."""
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, Sequence) else ()
    if isinstance(value, str) or not isinstance(value, (Mapping, Sequence)):
        yield name, value
    else:
        for key, entry in inner:
            yield from _flat(f"{name}.{key}", entry)


def write_trial_table(path: Path, results: Sequence[CellResult]) -> None:
    """Write the table of all trials of the cells; the SQLite file appears complete or not at all."""
    rows = [row for result in results for row in _rows(path.parent, result)]
    factors = list(dict.fromkeys(name for result in results for name in _factors(result)))
    columns = [
        ("cell", "text", "", "cell of the grid, or name of the scenario"),
        *((factor, "any", "", "factor of the grid") for factor in factors),
        *(
            (figure.column, figure.kind, figure.unit, figure.column_meaning)
            for figure in trial_columns()
            if not figure.is_optional or any(figure.column in row for row in rows)
        ),
        ("policy", "text", "", "policy that chose where to look, as JSON; null where there is none"),
        ("options", "text", "", "options the filter was made with, as JSON"),
        ("series", "text", "", "time series of the trial (npz), relative to this file"),
    ]
    unfinished = unfinished_name(path)
    try:
        with closing(sqlite3.connect(unfinished)) as database, database:
            declared = ", ".join(f"{_quoted(name)} {_TYPES[kind]}" for name, kind, _, _ in columns)
            database.execute(f"PRAGMA user_version = {SCHEMA}")
            database.execute(f"CREATE TABLE trials ({declared})")
            database.execute("CREATE TABLE columns (name TEXT PRIMARY KEY, unit TEXT, meaning TEXT)")
            meanings = [(name, unit, meaning) for name, _, unit, meaning in columns]
            database.executemany("INSERT INTO columns VALUES (?, ?, ?)", meanings)
            places = ", ".join("?" for _ in columns)
            values = [[row.get(name) for name, *_ in columns] for row in rows]
            database.executemany(f"INSERT INTO trials VALUES ({places})", values)
        unfinished.replace(path)
    except sqlite3.OperationalError as error:
        raise OSError(f"{path} cannot be written: {error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def _rows(root: Path, result: CellResult) -> list[dict[str, Any]]:
    rows = []
    competitors = {choice.label: choice for choice in result.cell.scenario.competitors}
    options = {summary.filter_name: json.dumps(dict(summary.options)) for summary in result.summaries}
    for of_seed in zip(*(result.figures[label].of_run.values() for label in competitors), strict=True):
        for figures in of_seed:
            choice = competitors[figures["filter"]]
            rows.append(
                {
                    "cell": result.cell.name,
                    **_factors(result),
                    **{FIGURES[name].column: FIGURES[name].in_unit(value) for name, value in figures.items()},
                    "policy": None if choice.policy is None else json.dumps(choice.policy.as_dict()),
                    "options": options[choice.label],
                    "series": result.directory.trial_path(figures["seed"], choice).relative_to(root).as_posix(),
                }
            )
    return rows


def _factors(result: CellResult) -> dict[str, Any]:
    return {f"factor.{name}": level for name, level in result.cell.factors.items()}


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
