"""Significant changes between two runs of the benchmark, say before and after a change of a filter.

A grid is compared cell by cell. Recordings with bit-identical measurements are compared pair by pair. Where the
measurements are not the same, the runs are two samples, and their difference has the wider interval of unpaired data.
Intervals and tests are corrected for all changes of the table that could have shown something; those of time, which
depends on the machine, among themselves.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from filters.validation import BoolArray, FloatArray
from stereo_slam_env.benchmark.scenarios.streams import pairing_digest
from stereo_slam_env.benchmark.statistics.differences import TIE_PERCENT, Finding, pairs_needed, share_difference
from stereo_slam_env.benchmark.statistics.measures import DIVERGED, MEASURES, TIME, change_words, difference_by
from stereo_slam_env.benchmark.storage.store import SETTINGS, read_study
from stereo_slam_env.evaluation.figures import Figure
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.run_figures import RunFigures, RunKey, common_keys, key_of
from stereo_slam_env.files.readers import read_json

if TYPE_CHECKING:
    from stereo_slam_env.benchmark.campaign import BenchmarkResult

_MACHINE = ("platform", "python", "numpy", "scipy")


@dataclass(frozen=True)
class Change:
    """One measure of one filter, before and after."""

    filter_name: str  # label; in a grid with the name of the cell before it
    measure: str  # in words: "position error", "diverged runs"
    unit: str  # of `before` and `after`; may be empty
    # Over the common recordings: geometric mean over runs, of consistency the mean, of divergences their number.
    before: float
    after: float
    count: int  # recordings, pairs where they are paired
    # Of by how much it became larger; of consistency, of how much farther from the ideal it came; None where there is
    # none (too few runs, divergences).
    interval_percent: tuple[float, float] | None
    p_value: float  # corrected
    finding: Finding  # better or worse after than before, or no difference shown
    words: str


@dataclass(frozen=True)
class RunComparison:
    """Changes from one run of the benchmark to another one.

    Attributes
    ----------
    before, after : str
        Where they are.
    paired : bool
        Whether their measurements are bit-identical, recording by recording.
    changes : tuple of Change
        By filter, then measure.
    filters_before, filters_after, recordings_before, recordings_after : tuple of str
        Filters and recordings that only one of them has.
    warnings : tuple of str
        What the reader must know before believing the table, one sentence each.
    headline : str
        What changed significantly, in a few sentences.
    """

    before: str
    after: str
    paired: bool
    changes: tuple[Change, ...]
    filters_before: tuple[str, ...]
    filters_after: tuple[str, ...]
    recordings_before: tuple[str, ...]
    recordings_after: tuple[str, ...]
    warnings: tuple[str, ...]
    headline: str

    @property
    def shown(self) -> tuple[Change, ...]:
        """The changes that the runs show."""
        return tuple(change for change in self.changes if change.finding is not Finding.NOT_SHOWN)

    def as_rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """Cells of a table: filter, measure, before, after, change, finding; see `COLUMNS`."""
        return [
            (
                change.filter_name,
                f"{change.measure}, {change.unit}" if change.unit else change.measure,
                f"{change.before:.4g}",
                f"{change.after:.4g}",
                change.words,
                change.finding.value,
            )
            for change in self.changes
        ]

    def __str__(self) -> str:
        return "\n".join([self.headline, *self.warnings, *(" | ".join(row) for row in self.as_rows())])


COLUMNS = ("filter", "measure", "before", "after", "change", "finding")


def compare(before: str | Path | BenchmarkResult, after: str | Path | BenchmarkResult) -> RunComparison:
    """Find the significant changes between two runs of the benchmark.

    Parameters
    ----------
    before, after : str, Path or BenchmarkResult
        Run directories, or results that are still at hand.

    Raises
    ------
    ValueError
        No run there, it is not finished, or the two have no filter in common.
    """
    was, now = _opened(before, "before"), _opened(after, "after")
    filters = [name for name in was.figures if name in now.figures]
    keys = [key for key in was.keys if key in set(now.keys)]
    if not filters:
        raise ValueError(
            f"{was.name} and {now.name} have no filter in common: {', '.join(was.figures)} against "
            f"{', '.join(now.figures)}"
        )
    paired, about_streams = _same_streams(was, now)
    changes = _changes(was, now, filters, paired)
    warnings = [*_failures(was), *_failures(now), *about_streams, *_other_settings(was, now), *_other_machine(was, now)]
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
        headline=_headline(changes),
    )


@dataclass(frozen=True)
class _Side:
    """A run of the benchmark, as far as it is compared: filters go by their labels, in a grid by "cell: label"."""

    name: str
    figures: Mapping[str, RunFigures]
    trials: Mapping[tuple[str, RunKey], FilterRun]
    streams: Mapping[tuple[str, RunKey], str] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def keys(self) -> list[RunKey]:
        """Its recordings."""
        return list(dict.fromkeys(key for _, key in self.trials))


def _opened(source: str | Path | BenchmarkResult, name: str) -> _Side:
    if not isinstance(source, (str, Path)):
        out = getattr(source, "out", None)
        if out is None or not Path(out).is_dir():
            return _Side(name, source.figures, {(run.filter_name, key_of(run)): run for run in source.runs})
        source = Path(out)
    study = read_study(Path(source))
    figures: dict[str, RunFigures] = {}
    trials: dict[tuple[str, RunKey], FilterRun] = {}
    streams: dict[tuple[str, RunKey], str] = {}
    settings: dict[str, Mapping[str, Any]] = {}
    for directory in study.cells:
        prefix = f"{directory.cell.name}: " if study.study.is_grid else ""
        found = directory.results()
        digests = {(about["name"], about["seed"]): pairing_digest(about) for about in found.recordings}
        for run in found.runs:
            trial = f"{prefix}{run.filter_name}", key_of(run)
            trials[trial], streams[trial] = run, digests[key_of(run)]
        figures |= {f"{prefix}{label}": of_filter for label, of_filter in found.figures.items()}
        settings[prefix] = read_json(directory.out / SETTINGS)
    return _Side(str(source), figures, trials, streams, settings)


def _same_streams(was: _Side, now: _Side) -> tuple[bool, list[str]]:
    """Whether all common trials had the same measurements, and warnings about it."""
    common = [trial for trial in was.trials if trial in now.trials]
    if not common:
        return False, ["The two runs have no recording in common: they are compared as two samples, not pair by pair."]
    if all(trial in side.streams for side in (was, now) for trial in common):
        other = list(dict.fromkeys(trial[1] for trial in common if was.streams[trial] != now.streams[trial]))
        if not other:
            return True, []
        which = _recording(other[0]) + (f" and {len(other) - 1} more" if len(other) > 1 else "")
        return False, [
            f"The measurements of {which} are not the same in both runs: they are compared as two samples, not pair by "
            f"pair, and a difference may come from the recordings."
        ]
    pairs = [(was.trials[trial], now.trials[trial]) for trial in common]
    if all(
        np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True)
        for a, b in pairs
        for name in ("timestamps", "true_positions")
    ):
        return True, [
            "Whether the measurements are bit-identical is not known; time stamps and truth are, so runs are paired."
        ]
    return False, ["The drives of the two runs are not the same: they are compared as two samples, not pair by pair."]


def _changes(was: _Side, now: _Side, filters: Sequence[str], paired: bool) -> tuple[Change, ...]:
    """All changes; values that are identical before and after do not count as a comparison."""
    found = {(name, m): _values(was, now, name, m, paired) for name in filters for m in (*MEASURES, DIVERGED)}
    known = {
        (name, measure): values
        for (name, measure), values in found.items()
        if all(map(len, values)) and (measure is not DIVERGED or any(side.any() for side in values))
    }
    moved = [measure is TIME for (_, measure), values in known.items() if not np.array_equal(*values)]
    of_time, of_others = max(1, sum(moved)), max(1, len(moved) - sum(moved))
    return tuple(
        _change(name, measure, *values, paired, of_time if measure is TIME else of_others)
        for (name, measure), values in known.items()
    )


def _values(was: _Side, now: _Side, name: str, measure: Figure, paired: bool) -> tuple[FloatArray, FloatArray]:
    """Values of a measure in the runs after and before; of pairs, those that both know."""
    sides = now.figures[name], was.figures[name]
    common = common_keys(*reversed(sides))
    after, before = (side.values(measure, common if paired else list(side.of_run)) for side in sides)
    if not paired:
        return after[np.isfinite(after)], before[np.isfinite(before)]
    known = np.isfinite(after) & np.isfinite(before)
    return after[known], before[known]


def _change(
    name: str, measure: Figure, after: FloatArray, before: FloatArray, paired: bool, comparisons: int
) -> Change:
    if measure is DIVERGED:
        return _divergences(name, after > 0, before > 0, paired, comparisons)
    difference = difference_by(measure, after, before, paired=paired, comparisons=comparisons)
    percent = difference.reversed if measure.larger_is_better else difference
    return Change(
        filter_name=name,
        measure=measure.label,
        unit=measure.unit,
        before=over_runs(measure, before),
        after=over_runs(measure, after),
        count=difference.count,
        interval_percent=percent.interval_percent,
        p_value=difference.p_value,
        finding=difference.finding,
        words=change_words(measure, difference),
    )


def _divergences(name: str, after: BoolArray, before: BoolArray, paired: bool, comparisons: int) -> Change:
    share = share_difference(after, before, paired=paired, comparisons=comparisons)
    lost, are_lost = int(before.sum()), int(after.sum())
    words = f"{lost} of {len(before)} runs before, {are_lost} of {len(after)} after"
    if np.array_equal(after, before):
        words = f"the same {are_lost} of {len(after)} runs"
    elif share.finding is Finding.NOT_SHOWN:
        words = f"{words}, which may be chance"
    return Change(name, DIVERGED.label, "", lost, are_lost, share.count, None, share.p_value, share.finding, words)


def over_runs(measure: Figure, values: FloatArray) -> float:
    """One value for many runs: their geometric mean; of consistency and logarithms their mean; NaN without any."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return float("nan")
    if measure.ideal is not None or not measure.is_ratio or not (finite > 0.0).all():
        return float(finite.mean())
    return float(np.exp(np.log(finite).mean()))


def _failures(side: _Side) -> list[str]:
    """Number of failed runs of each filter, with the first error."""
    failed = [(label, run.failure) for (label, _), run in side.trials.items() if run.failure is not None]
    first = dict(reversed(failed))
    counts = Counter(label for label, _ in failed)
    return [f"{label} failed in {n} runs of {side.name}, first at {first[label]}." for label, n in counts.items()]


def _other_settings(was: _Side, now: _Side) -> list[str]:
    other: dict[str, None] = {}
    for cell in was.settings.keys() & now.settings.keys():
        a, b = (side.settings[cell]["scenario"] for side in (was, now))
        ignored = {"name", "seeds", "filters", "policies"}
        other |= dict.fromkeys(key for key in {**a, **b} if key not in ignored and a.get(key) != b.get(key))
        made = [
            {c["label"]: (c["name"], c["options"]) for c in (*side["filters"], *side.get("policies", ()))}
            for side in (a, b)
        ]
        changed = [label for label, how in made[0].items() if made[1].get(label, how) != how]
        other |= dict.fromkeys(f"the options of {label}" for label in changed)
    return [f"The settings of the two runs differ in {', '.join(other)}."] if other else []


def _other_machine(was: _Side, now: _Side) -> list[str]:
    a, b = (next((dict(about["versions"]) for about in side.settings.values()), {}) for side in (was, now))
    if not a or not b:
        return ["Times are of one machine only if both runs were made on it."]
    other = [f"{key} ({a.get(key)} and {b.get(key)})" for key in _MACHINE if a.get(key) != b.get(key)]
    if other:
        return [f"Times are not comparable: the two runs differ in {', '.join(other)}."]
    return ["Times were measured in two sessions: the load of the machine may differ."]


def _headline(changes: Sequence[Change]) -> str:
    sentences = []
    for finding in (Finding.WORSE, Finding.BETTER):
        shown = [f"{c.measure} of {c.filter_name}: {c.words}" for c in changes if c.finding is finding]
        if shown:
            sentences.append(f"{finding.value.capitalize()} after than before: {'; '.join(shown)}.")
    if sentences:
        return " ".join(sentences)
    others = [c.words for c in changes if c.measure != TIME.label]
    if all(words.startswith("the same") for words in others):
        tied = any(words.startswith("the same to within") for words in others)
        return f"Nothing has changed{f' by {TIE_PERCENT:g} % or more' if tied else ''} but perhaps the time."
    most, comparisons = max(c.count for c in changes), len(changes)
    if most < pairs_needed():
        return f"No difference is shown: {most} runs are too few, at least {pairs_needed()} are needed."
    return f"No difference is shown in {comparisons} comparisons."


def _recording(key: RunKey) -> str:
    name, seed = key
    return name if seed is None else f"{name} (seed {seed})"
