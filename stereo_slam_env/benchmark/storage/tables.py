"""Result tables on disk: summaries as JSON and CSV, and all trials as SQLite, for analysis with other tools.

The trial table is in docs/benchmark.md ("The run directory"); its table `columns` says what each column is. NULL is
what does not apply or is not finite.
"""

from __future__ import annotations

import csv
import io
import json
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stereo_slam_env.evaluation.figures import trial_columns
from stereo_slam_env.evaluation.run_figures import key_of
from stereo_slam_env.files.folders import unfinished_name, write_atomically
from stereo_slam_env.files.json_files import json_text

if TYPE_CHECKING:
    from stereo_slam_env.benchmark.storage.store import CellResult

SCHEMA = 3
_TYPES = {"text": "TEXT", "integer": "INTEGER", "real": "REAL", "any": ""}


def write_csv(path: Path, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Write summaries, one row for each filter; what does not apply is empty."""
    plain = json.loads(json_text(rows))
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["filter", *next(iter(plain.values()))])
    for label, row in plain.items():
        cells = (json.dumps(cell) if isinstance(cell, (list, dict)) else cell for cell in row.values())
        table.writerow([label, *cells])
    write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))


def write_trial_table(path: Path, results: Sequence[CellResult]) -> None:
    """Write the table of all trials of the cells; the SQLite file appears complete or not at all."""
    rows = [row for result in results for row in _rows(path.parent, result)]
    factors = list(dict.fromkeys(name for result in results for name in _factors(result)))
    columns = [
        ("cell", "text", "", "cell of the grid, or name of the scenario"),
        *((factor, "any", "", "factor of the grid") for factor in factors),
        *((figure.name, figure.kind, figure.unit, figure.meaning) for figure in trial_columns()),
        ("policy", "text", "", "policy that chose where to look, as JSON; null where there is none"),
        ("options", "text", "", "options the filter was made with, as JSON"),
        ("series", "text", "", "time series of the trial (npz), relative to this file"),
    ]
    unfinished = unfinished_name(path)
    unfinished.unlink(missing_ok=True)
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
    for run in result.runs:
        choice = competitors[run.filter_name]
        rows.append(
            {
                "cell": result.cell.name,
                **_factors(result),
                **result.figures[run.filter_name].of_run[key_of(run)],
                "policy": None if choice.policy is None else json.dumps(choice.policy.as_dict()),
                "options": json.dumps(dict(run.options)),
                "series": result.directory.trial_path(run.seed, choice).relative_to(root).as_posix(),
            }
        )
    return rows


def _factors(result: CellResult) -> dict[str, Any]:
    return {f"factor.{name}": level for name, level in result.cell.factors.items()}


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
