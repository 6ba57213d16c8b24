"""Significant changes between two runs of the benchmark, say before and after a change of a filter.

A grid is compared cell by cell. Recordings with bit-identical measurements are compared pair by pair. Where the
measurements are not the same, the runs are two samples, and their difference has the wider interval of unpaired data.
Recordings of different kinds are not compared at all. Intervals and tests are corrected for all changes of the table
that could have shown something; those of time, which depends on the machine, among themselves.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice
from stereo_slam_env.benchmark.scenarios.streams import pairing_digest
from stereo_slam_env.benchmark.statistics.changes import Change, RunComparison
from stereo_slam_env.benchmark.statistics.differences import Difference, ShareDifference, share_difference
from stereo_slam_env.benchmark.statistics.measures import DIVERGED, MEASURES, TIME, difference_by
from stereo_slam_env.benchmark.statistics.sentences import MOST_NAMED, few, sentence
from stereo_slam_env.benchmark.storage.result_tables import results_of
from stereo_slam_env.benchmark.storage.run_files import SETTINGS
from stereo_slam_env.benchmark.storage.store import RunDirectory, read_study
from stereo_slam_env.evaluation.figures import Figure
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import RunFigures, RunKey, common_keys, key_of, summarise
from stereo_slam_env.files.readers import read_json

if TYPE_CHECKING:
    from stereo_slam_env.benchmark.campaign import BenchmarkResult

_MACHINE = ("platform", "python", "numpy", "scipy")
_WHAT_IS_DRIVEN = ("name", "path", "call", "route", "surroundings")
"""Options of a source that say what is driven: where they differ, errors are not comparable."""


def compare(before: str | Path | BenchmarkResult, after: str | Path | BenchmarkResult) -> RunComparison:
    """Find the significant changes between two runs of the benchmark.

    Parameters
    ----------
    before, after : str, Path or BenchmarkResult
        Run directories, or results that are still at hand.

    Raises
    ------
    ValueError
        No run there, it is not finished, the two have no filter in common, or their recordings are of different kinds.
    """
    was, now = _opened(before, "before"), _opened(after, "after")
    _refuse_other_kinds(was, now)
    filters = [name for name in was.figures if name in now.figures]
    keys = [key for key in was.keys if key in set(now.keys)]
    if not filters:
        raise ValueError(
            f"{was.name} and {now.name} have no filter in common: {few(list(was.figures))} against "
            f"{few(list(now.figures))}"
        )
    paired, about_streams = _same_streams(was, now)
    changes = _changes(was, now, filters, paired)
    warnings = [*_failures(was), *_failures(now), *about_streams, *_other_settings(was, now)]
    warnings += [*_other_code(was, now), *_other_machine(was, now)]
    return RunComparison(
        before=was.name,
        after=now.name,
        paired=paired,
        changes=changes,
        filters_before=tuple(name for name in was.figures if name not in now.figures),
        filters_after=tuple(name for name in now.figures if name not in was.figures),
        recordings_before=tuple(_recording(key) for key in was.keys if key not in keys),
        recordings_after=tuple(_recording(key) for key in now.keys if key not in keys),
        warnings=tuple(warnings),
    )


@dataclass(frozen=True)
class _Side:
    """A run of the benchmark, as far as it is compared: filters go by their labels, in a grid by "cell: label"."""

    name: str
    figures: Mapping[str, RunFigures]
    summaries: Mapping[str, FilterSummary]  # over all runs of a filter
    runs: Callable[[str], Iterable[FilterRun]]  # all runs of a filter, read when they are asked for
    streams: Mapping[tuple[str, RunKey], str] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    plugin_code: Mapping[str, str | None] = field(default_factory=dict)  # digest by label; None: it is ours
    cells: Mapping[str, str] = field(default_factory=dict)  # of a grid, by name of the filter

    @cached_property
    def trials(self) -> dict[tuple[str, RunKey], Mapping[str, Any]]:
        """Figures of every run."""
        return {(name, key): row for name, of in self.figures.items() for key, row in of.of_run.items()}

    @property
    def keys(self) -> list[RunKey]:
        """Recordings of the run, each once."""
        return list(dict.fromkeys(key for _, key in self.trials))

    def over(self, name: str, keys: Sequence[RunKey]) -> FilterSummary:
        """Figures of a filter over its runs on these recordings: kept ones where that is all of them."""
        if set(keys) == set(self.figures[name].of_run):
            return self.summaries[name]
        runs_by_key = {key_of(run): run for run in self.runs(name) if key_of(run) in set(keys)}
        return summarise([runs_by_key[key] for key in keys], self.figures[name])


def _opened(source: str | Path | BenchmarkResult, name: str) -> _Side:
    if not isinstance(source, (str, Path)):
        out = getattr(source, "out", None)
        if out is None or not Path(out).is_dir():
            by_filter: dict[str, list[FilterRun]] = {}
            for run in source.runs:
                by_filter.setdefault(run.filter_name, []).append(run)
            summaries = {label: summarise(runs, source.figures[label]) for label, runs in by_filter.items()}
            return _Side(name, source.figures, summaries, by_filter.__getitem__)
        source = Path(out)
    study = read_study(Path(source))
    figures: dict[str, RunFigures] = {}
    summaries = {}
    places: dict[str, tuple[RunDirectory, FilterChoice]] = {}
    streams: dict[tuple[str, RunKey], str] = {}
    settings: dict[str, Mapping[str, Any]] = {}
    code: dict[str, str | None] = {}
    cells: dict[str, str] = {}
    for directory in study.cells:
        prefix = f"{directory.cell.name}: " if study.study.is_grid else ""
        result = results_of(directory)
        digests = {(about["name"], about["seed"]): pairing_digest(about) for about in result.recordings}
        for choice, summary in zip(directory.scenario.competitors, result.summaries, strict=True):
            label = f"{prefix}{choice.label}"
            figures[label], summaries[label], places[label] = (
                result.figures[choice.label],
                summary,
                (directory, choice),
            )
            streams |= {(label, key): digests[key] for key in figures[label].of_run}
        code |= {f"{prefix}{label}": digest for label, digest in directory.plugin_code().items()}
        cells |= {f"{prefix}{label}": directory.cell.name for label in result.figures if prefix}
        settings[prefix] = read_json(directory.out / SETTINGS)

    def runs_of(label: str) -> Iterator[FilterRun]:
        directory, choice = places[label]
        return (trial.run for trial in directory.trials(choice, {}))

    return _Side(str(source), figures, summaries, runs_of, streams, settings, code, cells)


def _refuse_other_kinds(was: _Side, now: _Side) -> None:
    """Raise a `ValueError` where what is driven is not the same in both runs: errors are then not comparable."""
    common = [cell for cell in was.settings if cell in now.settings]
    either = zip(was.settings, now.settings, strict=False)
    for cell, other in [(cell, cell) for cell in common] or list(either)[:1]:
        a, b = _driven(was.settings[cell]["scenario"]), _driven(now.settings[other]["scenario"])
        if a != b if common else a["kind"] != b["kind"]:
            raise ValueError(
                f"{was.name} is of {_kind_words(a)}, {now.name} of {_kind_words(b)}: compare runs on the same kind of "
                f"recordings"
            )


def _driven(scenario: Mapping[str, Any]) -> dict[str, Any]:
    options = scenario.get("options", {})
    return {"kind": scenario.get("kind"), **{key: options[key] for key in _WHAT_IS_DRIVEN if options.get(key)}}


def _kind_words(driven: Mapping[str, Any]) -> str:
    options = ", ".join(f"{key} {value!r}" for key, value in driven.items() if key != "kind")
    return f"kind {driven['kind']!r}" + (f" ({options})" if options else "")


def _same_streams(was: _Side, now: _Side) -> tuple[bool, list[str]]:
    """Whether all common trials had the same measurements, and warnings about it."""
    common = [trial for trial in was.trials if trial in now.trials]
    if not common:
        return False, [sentence("no_recording_in_common")]
    if all(trial in side.streams for side in (was, now) for trial in common):
        other = list(dict.fromkeys(trial[1] for trial in common if was.streams[trial] != now.streams[trial]))
        if not other:
            return True, []
        return False, [sentence("other_measurements", [_recording(key) for key in other])]
    drives = [{(name, key_of(run)): run for name in side.figures for run in side.runs(name)} for side in (was, now)]
    if all(
        np.array_equal(getattr(drives[0][trial], name), getattr(drives[1][trial], name), equal_nan=True)
        for trial in common
        for name in ("timestamps", "true_positions")
    ):
        return True, [sentence("measurements_not_known")]
    return False, [sentence("other_drives")]


def _changes(was: _Side, now: _Side, filters: Sequence[str], paired: bool) -> tuple[Change, ...]:
    """All changes; values that are identical before and after do not count as a comparison."""
    both = {(name, m): _values(was, now, name, m, paired) for name in filters for m in (*MEASURES, DIVERGED)}
    known = {
        (name, measure): values
        for (name, measure), values in both.items()
        if all(map(len, values)) and (measure is not DIVERGED or any(side.any() for side in values))
    }
    moved = [measure is TIME for (_, measure), values in known.items() if not np.array_equal(*values)]
    of_time, of_others = max(1, sum(moved)), max(1, len(moved) - sum(moved))
    over = {name: _over_runs(was, now, name, paired) for name in filters}
    changes = []
    for (name, measure), (after, before) in known.items():
        comparisons = of_time if measure is TIME else of_others
        values, runs = [measure.of(summary) for summary in over[name]], (len(before), len(after))
        difference: Difference | ShareDifference
        if measure is DIVERGED:
            values = [float(before.sum()), float(after.sum())]
            difference = share_difference(after > 0, before > 0, paired=paired, comparisons=comparisons)
        else:
            difference = difference_by(measure, after, before, paired=paired, comparisons=comparisons)
        changes.append(Change(name, measure, values[0], values[1], runs, difference, now.cells.get(name, "")))
    return tuple(changes)


def _values(was: _Side, now: _Side, name: str, measure: Figure, paired: bool) -> tuple[FloatArray, FloatArray]:
    """Values of a measure in the runs after and before; of pairs, those that both know."""
    sides = now.figures[name], was.figures[name]
    common = common_keys(*reversed(sides))
    after, before = (side.values(measure, common if paired else list(side.of_run)) for side in sides)
    if not paired:
        return after[np.isfinite(after)], before[np.isfinite(before)]
    finite = np.isfinite(after) & np.isfinite(before)
    return after[finite], before[finite]


def _over_runs(was: _Side, now: _Side, name: str, paired: bool) -> tuple[FilterSummary, FilterSummary]:
    """Figures of a filter before and after over its runs; of pairs, over those on the common recordings."""
    common = common_keys(was.figures[name], now.figures[name])
    before, after = (side.over(name, common if paired else list(side.figures[name].of_run)) for side in (was, now))
    return before, after


def _failures(side: _Side) -> list[str]:
    """Number of failed runs of the filters, with the first error of each."""
    failed = [(label, row["failure"]) for (label, _), row in side.trials.items() if row["failure"] is not None]
    first, counts = dict(reversed(failed)), Counter(label for label, _ in failed)
    lines = [sentence("failed_runs", label, n, side.name, first[label]) for label, n in counts.items()]
    more = len(lines) - MOST_NAMED
    return [*lines[:MOST_NAMED], sentence("more_failed", more, side.name)] if more > 0 else lines


def _other_settings(was: _Side, now: _Side) -> list[str]:
    other: dict[str, None] = {}
    for cell in was.settings.keys() & now.settings.keys():
        a, b = (side.settings[cell]["scenario"] for side in (was, now))
        ignored = {"name", "seeds", "filters", "policies"}
        other |= dict.fromkeys(key for key in {**a, **b} if key not in ignored and a.get(key) != b.get(key))
        changes = [
            {c["label"]: (c["name"], c["options"]) for c in (*side["filters"], *side.get("policies", ()))}
            for side in (a, b)
        ]
        changed = [label for label, how in changes[0].items() if changes[1].get(label, how) != how]
        other |= dict.fromkeys(f"the options of {label}" for label in changed)
    return [sentence("other_settings", list(other))] if other else []


def _other_code(was: _Side, now: _Side) -> list[str]:
    """Names whose code differs: of filters by others, and of this project."""
    common = [label for label in was.plugin_code if label in now.plugin_code]
    other = [label for label in common if was.plugin_code[label] != now.plugin_code[label]]
    ours = [next((about["versions"].get("code") for about in side.settings.values()), None) for side in (was, now)]
    codes = [other] if other else []
    if None not in ours and ours[0] != ours[1]:
        codes.append([f"stereo-slam-env ({ours[0]} and {ours[1]})"])
    return [sentence("other_code", names) for names in codes]


def _other_machine(was: _Side, now: _Side) -> list[str]:
    a, b = (next((dict(about["versions"]) for about in side.settings.values()), {}) for side in (was, now))
    other = [f"{key} ({a.get(key)} and {b.get(key)})" for key in _MACHINE if a.get(key) != b.get(key)]
    return [sentence("other_machine", other if a and b else None)]


def _recording(key: RunKey) -> str:
    name, seed = key
    return name if seed is None else f"{name} (seed {seed})"
