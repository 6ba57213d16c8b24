"""The report of a benchmark: a page for each cell, and one over all cells of a grid."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.statistics.attribution import Attribution, attribute_runs
from stereo_slam_env.benchmark.statistics.policy_verdict import Looks, baseline_of
from stereo_slam_env.benchmark.storage.store import CellResult, StudyDirectory
from stereo_slam_env.recording.archive import load_recording
from stereo_slam_env.report.run_report import write_report
from stereo_slam_env.report.study_report import write_study_report

_log = logging.getLogger(__name__)


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
            result.directory.settings(),
            bounds=result.bounds,
            attribution=None if factorial is None else attribution_of(factorial, result),
            looks=looks_of(result) if result.cell.scenario.policies else None,
        )
        for result in results
    ]
    if not directory.study.is_grid:
        return pages[0]
    return write_study_report(directory.out, directory.study, {result.cell.name: result for result in results})


def looks_of(result: CellResult) -> Looks:
    """Who is held against whom, and where all looked in the first seed; recordings that are gone are left out."""
    competitors, seed = result.cell.scenario.competitors, result.directory.seeds[0]
    paths = {choice.label: result.directory.recording_path(seed, choice) for choice in competitors}
    seen = {label: load_recording(path) for label, path in paths.items() if path.exists()}
    return Looks(baseline_of(competitors), seen)


def attribution_of(factorial: Mapping[str, Sequence[Any]], result: CellResult) -> Attribution | None:
    """Which option of the filter makes the difference in this cell; None where too little is left to tell."""
    try:
        return attribute_runs(factorial, result.figures)
    except ValueError as error:
        _log.warning("no attribution for %s: %s", result.cell.name, error)
        return None
