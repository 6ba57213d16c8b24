"""The run directory of a study: that of its scenario, or one a cell and what they have in common.

Layout of a grid::

    study.json                the exact inputs: name, cells with their factors and scenarios, factorial
    summary.json              {"version": 2, "study": str, "cells": {<cell>: {"factors": {...}, "filters": {...}}}}
    trials.sqlite             every trial of every cell, one row each, see `trial_table`
    report.html, figures/     what is in common
    cells/<cell>/             the run directory of the cell, see `store`
    recordings/<stream>/      shared by the cells that run on the same streams

A study of one scenario has `study.json` and `trials.sqlite` beside what `store` describes, in one directory.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from stereo_slam_env.benchmark.scenarios.study import Cell, Study
from stereo_slam_env.benchmark.storage import store
from stereo_slam_env.benchmark.storage.results import RunResults
from stereo_slam_env.benchmark.storage.store import CELLS, STUDY, RunDirectory, refuse_foreign
from stereo_slam_env.benchmark.storage.trial_table import write_trial_table


@dataclass(frozen=True, eq=False)
class CellResult(RunResults):
    """What came out in one cell.

    Attributes
    ----------
    cell : Cell
        What was run.
    directory : RunDirectory
        Where it is.
    """

    cell: Cell
    directory: RunDirectory


class StudyDirectory:
    """A study on disk. `open_study` starts or resumes one, `read_study` reads one."""

    def __init__(self, out: Path, study: Study) -> None:
        self.out = out
        self.study = study

    @property
    def cells(self) -> list[tuple[Cell, RunDirectory]]:
        """The cells and their directories."""
        if not self.study.is_grid:
            cell = self.study.cells[0]
            return [(cell, RunDirectory(self.out, cell.scenario))]
        return [(cell, RunDirectory(self.out / CELLS / cell.name, cell.scenario)) for cell in self.study.cells]

    def write_results(self) -> list[CellResult]:
        """Write tables and trajectories from the finished trials, and return what they say."""
        results = []
        for cell, directory in self.cells:
            found = directory.write_results()
            results.append(CellResult(**vars(found), cell=cell, directory=directory))
        if self.study.is_grid:
            cells = {
                result.cell.name: {
                    "factors": dict(result.cell.factors),
                    "filters": {summary.filter_name: store.summary_row(summary) for summary in result.summaries},
                }
                for result in results
            }
            store.write_json(
                self.out / "summary.json", {"version": store.VERSION, "study": self.study.name, "cells": cells}
            )
        write_trial_table(self.out / "trials.sqlite", results)
        return results


def open_study(out: Path, study: Study) -> StudyDirectory:
    """Start a study, or resume the one in `out`: finished trials of the same settings are kept.

    Raises
    ------
    ValueError
        `out` is a file, or holds something else.
    """
    directory = prepared_study(out, study)
    store.write_json(out / STUDY, study.as_dict())
    for cell, run in directory.cells:
        store.open_run(run.out, cell.scenario)
    return directory


def prepared_study(out: Path, study: Study) -> StudyDirectory:
    """What `open_study` would return, with nothing written yet.

    Raises
    ------
    ValueError
        As `open_study`.
    """
    refuse_foreign(out)
    if (out / STUDY).exists():
        before = read_study(out).study
        if study.is_grid != before.is_grid:
            raise ValueError(f"output {out} holds a run of {before.name!r}: choose another output directory")
    directory = StudyDirectory(out, study)
    for cell, run in directory.cells:
        if study.is_grid or (out / STUDY).exists():
            store.prepared_run(run.out, cell.scenario)
    return directory


def read_study(out: Path) -> StudyDirectory:
    """The study in a directory; one cell of a grid is a study, too.

    Raises
    ------
    ValueError
        No study there, or its settings are damaged.
    """
    path = out / STUDY
    if not path.exists():
        run = store.read_run(out)
        return StudyDirectory(out, Study.of(run.scenario))
    try:
        return StudyDirectory(out, Study.from_dict(json.loads(path.read_text(encoding="utf-8"))))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error
