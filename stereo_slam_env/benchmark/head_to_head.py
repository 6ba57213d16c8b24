"""Comparison of a filter with a reference, for unit tests: `Bench` runs both, `HeadToHead` has assertions.

Everything happens in this process and nothing is written: filters need not be registered, a class will do. Recordings
and runs are kept, so that the same reference filter is run once however many filters are held against it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from filters.catalogue.registry import FilterFactory, label_of, require_filter, usual_options
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.streams import make_recording
from stereo_slam_env.benchmark.scenarios.study import preset
from stereo_slam_env.benchmark.statistics.differences import Difference, ShareDifference, share_difference, signed
from stereo_slam_env.benchmark.statistics.measures import DIVERGED, MEASURES, POSITION, difference_between, pose_nees
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.benchmark.statistics.verdict import Consistency, consistency
from stereo_slam_env.evaluation.figures import Figure
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import RunFigures, common_keys, figures_of, summarise_all
from stereo_slam_env.recording.recording import Recording

FilterLike = str | FilterFactory
"""A name of `filters.available_filters()`, or what is called as `MyFilter(camera=..., noise=..., **options)`."""

QUICK = Scenario(
    "8 s of pure geometry",
    ReferenceSource("long_drive", {"landmarks": 30}),
    frames=80,
    noise={"independent_pixels": 1.0},
    gate=None,
)
"""Default scenario of filter tests: the models hold exactly, so that consistency can be asserted."""


def which_seeds(seeds: int | Sequence[int]) -> tuple[int, ...]:
    """Seeds of so many recordings, or these; raises a `ValueError` without any."""
    which = tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)
    if not which:
        raise ValueError(f"seeds must be at least one, got {seeds!r}")
    return which


@dataclass(frozen=True)
class HeadToHead:
    """A filter against a reference on the same recordings; its assertions say the figures when they fail."""

    # Of the filter, and of what it is held against.
    summary: FilterSummary
    reference: FilterSummary
    runs: tuple[FilterRun, ...]  # runs of the filter, one for each recording
    # Figures of the runs of both.
    figures: RunFigures
    reference_figures: RunFigures
    title: str

    def difference(self, measure: Figure = POSITION) -> Difference:
        """Difference by which a measure of the filter is worse than that of the reference."""
        return difference_between(self.figures, self.reference_figures, measure)

    def divergences(self) -> ShareDifference:
        """Whether the filter diverges in more recordings than the reference."""
        keys = common_keys(self.figures, self.reference_figures)
        return share_difference(self.figures.diverged(keys), self.reference_figures.diverged(keys))

    def assert_not_worse(self, percent: float = 5.0, *, measure: Figure = POSITION) -> None:
        """Assert that an error is shown to be at most `percent` larger than that of the reference.

        The whole 95 % interval of the paired difference must lie below `percent`: few runs, or runs that scatter, show
        nothing, and the message says how many it would take.

        Raises
        ------
        AssertionError
            It is worse, or that it is not is not shown.
        """
        __tracebackhide__ = True  # pytest then shows the test, not this
        self.assert_completed()
        difference = self.difference(measure)
        if difference.not_worse_than(percent):
            return
        name, other = self.summary.filter_name, self.reference.filter_name
        evidence = f"its {measure.label} is at {signed(difference.percent, 1)} % ({difference.evidence})"
        if difference.interval_percent is not None and difference.interval_percent[0] > percent:
            raise AssertionError(f"{name} is worse than {other} by more than {percent:g} %: {evidence}.\n{self}")
        seeds = difference.pairs_to_show(percent)
        remedy = f" With scatter like this, some {seeds} seeds could show it." if seeds else ""
        raise AssertionError(
            f"{name} is not shown to be at most {percent:g} % worse than {other}: {evidence}.{remedy}\n{self}"
        )

    def assert_better(self, *, measure: Figure = POSITION) -> None:
        """Assert that an error is shown to be smaller than that of the reference, by interval and signed-rank test."""
        __tracebackhide__ = True  # pytest then shows the test, not this
        self.assert_completed()
        difference = self.difference(measure)
        name, other = self.summary.filter_name, self.reference.filter_name
        if not (difference.shown and difference.estimate < 0.0):
            evidence = f"its {measure.label} is at {signed(difference.percent, 1)} % ({difference.evidence})"
            raise AssertionError(f"{name} is not shown to be better than {other}: {evidence}.\n{self}")

    def assert_consistent(self, *, or_cautious: bool = False) -> None:
        """Assert that the mean pose NEES lies in its 95 % band (or, with `or_cautious`, below it)."""
        __tracebackhide__ = True  # pytest then shows the test, not this
        self.assert_completed()
        state = consistency(self.summary)
        if state is Consistency.CONSISTENT or (or_cautious and state is Consistency.CAUTIOUS):
            return
        name = self.summary.filter_name
        if state is Consistency.UNKNOWN:
            raise AssertionError(f"{name} is not known to be consistent: it has no pose NEES.\n{self}")
        mean, band = pose_nees(self.summary)
        sentence = (
            f"{name} is {state.value}" if not self.summary.doubt else f"{name} is not judged ({self.summary.doubt})"
        )
        raise AssertionError(
            f"{sentence}: its mean pose NEES / 6 is {mean}, the band of {self.summary.runs} runs is {band}.\n{self}"
        )

    def assert_faster_than(self, ms: float) -> None:
        """Assert that the median frame takes less than `ms` milliseconds (predict + update, one BLAS thread)."""
        __tracebackhide__ = True
        took = self.summary.ms_per_frame
        if took is None or not took < ms:
            time = "an unknown time" if took is None else f"{took:.2f} ms"
            raise AssertionError(f"{self.summary.filter_name} takes {time} a frame, not less than {ms:g} ms.\n{self}")

    def assert_completed(self) -> None:
        """Assert that no run failed or diverged."""
        __tracebackhide__ = True
        if self.summary.diverged:
            why = f" ({self.summary.failures[0]})" if self.summary.failures else ""
            lost = f"diverged or failed in {self.summary.diverged} of {self.summary.runs} runs"
            raise AssertionError(f"{self.summary.filter_name} {lost}{why}.\n{self}")

    def __str__(self) -> str:
        """Figures of both as a table, with findings, remarks and failures."""
        sides = (self.summary, self.reference)
        rows = [("", *(side.filter_name for side in sides), f"run by run {self.summary.filter_name} is")]
        for measure in MEASURES:
            values = [measure.of(side) for side in sides]
            if not all(value != value for value in values):
                difference = self.difference(measure)
                words = f"{difference.finding.value}: " * difference.shown + sentence("change", measure, difference)
                rows.append((measure.title, *map(measure.text_of, values), words))
        diverged = (f"{side.diverged} of {side.runs}" for side in sides)
        rows.append((DIVERGED.label, *diverged, self.divergences().finding.value))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines += [f"note: {remark}" for side in sides for remark in side.remarks]
        lines += [f"{side.filter_name} failed: {failure}" for side in sides for failure in side.failures]
        return "\n".join([f"{self.title}, {self.summary.runs} seeds", *lines])


class Bench:
    """Runner of filters that keeps recordings and runs.

    >>> bench = Bench(seeds=10)
    >>> bench("shared-anchor", against="inverse-depth").assert_not_worse(5)  # doctest: +SKIP

    Parameters
    ----------
    seeds : int
        How many recordings, unless a call says otherwise.
    """

    def __init__(self, seeds: int = 10) -> None:
        if seeds < 1:
            raise ValueError(f"seeds must be >= 1, got {seeds!r}")
        self.seeds = seeds
        self._recordings: dict[tuple[str, int], Recording] = {}
        self._runs: dict[tuple[object, str, str, int], FilterRun] = {}

    def __call__(
        self,
        tested: FilterLike,
        *,
        against: FilterLike = "inverse-depth",
        scenario: Scenario | str | None = None,
        seeds: int | Sequence[int] | None = None,
        options: Mapping[str, Any] | None = None,
        against_options: Mapping[str, Any] | None = None,
    ) -> HeadToHead:
        """Run a filter and a reference on the same recordings.

        Parameters
        ----------
        tested, against : str or callable
            A name of `filters.available_filters()`, or a filter class or a function, called as
            `MyFilter(camera=..., noise=..., **options)`.
        scenario : Scenario or str, optional
            What to run on, or the name of a preset; None: `QUICK`. Its own filters and seeds play no part.
        seeds : int or sequence of int, optional
            How many recordings, or which.
        options, against_options : mapping, optional
            Options of the two, JSON-able; None: those of the benchmark.
        """
        on = QUICK if scenario is None else preset(scenario) if isinstance(scenario, str) else scenario
        which = which_seeds(self.seeds if seeds is None else seeds)
        name, other = label_of(tested), label_of(against)
        if name == other:
            other = f"{other} (reference)"
        sides = (tested, name, options), (against, other, against_options)
        runs = [self._run(*side, on, seed) for side in sides for seed in which]
        figures = figures_of(runs, divergence_percent=on.divergence_percent)
        summary, reference = summarise_all(runs, figures)
        return HeadToHead(summary, reference, tuple(runs[: len(which)]), figures[name], figures[other], on.name)

    def _run(
        self, tested: FilterLike, label: str, options: Mapping[str, Any] | None, scenario: Scenario, seed: int
    ) -> FilterRun:
        if options is None:
            options = usual_options(tested)
        require_filter(tested, options)
        source = json.dumps(scenario.as_dict(), sort_keys=True)
        key = (tested, f"{label} {json.dumps(dict(options), sort_keys=True)}", source, seed)
        if key not in self._runs:
            if (source, seed) not in self._recordings:
                self._recordings[source, seed] = make_recording(scenario, seed)
            recording = self._recordings[source, seed]
            self._runs[key] = run_filter(
                recording,
                tested,
                options,
                label=label,
                seed=seed,
            )
        return self._runs[key]
