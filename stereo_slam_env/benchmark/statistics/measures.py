"""Measures that filters are compared by, and the comparison of each filter with each other one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.benchmark.statistics.differences import (
    Difference,
    Finding,
    difference_of,
    paired_difference,
    percent_words,
    unpaired_difference,
)
from stereo_slam_env.evaluation.figures import FIGURES, Figure
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures, RunFigures, RunKey, common_keys


@dataclass(frozen=True)
class Measure:
    """Measure of comparison: a figure, divided by its ideal value where it has one."""

    figure: Figure  # entry of the table of figures

    @property
    def key(self) -> str:
        """Name of the figure."""
        return self.figure.name

    @property
    def words(self) -> str:
        """Name in tables and sentences: "position error"."""
        return self.figure.label

    @property
    def unit(self) -> str:
        """Unit of a value; may be empty."""
        return self.figure.unit

    @property
    def ideal(self) -> float | None:
        """Value of a consistent filter, 1, for a measure of consistency; None: the smaller the better."""
        return None if self.figure.ideal is None else 1.0

    def of(self, figures: FilterSummary | Mapping[str, Any]) -> float:
        """The value in a summary or in the figures of a run; NaN where it is not known."""
        values = figures.figures if isinstance(figures, FilterSummary) else figures
        return self.figure.shown(values.get(self.key))

    def by_run(self, figures: RunFigures, keys: Iterable[RunKey]) -> FloatArray:
        """The values in the runs on these recordings, in this order; NaN where not known."""
        return np.array([self.of(figures.of_run[key]) for key in keys])

    def over_runs(self, values: FloatArray) -> float:
        """One value for many runs: their geometric mean; of consistency and logarithms their mean; NaN without any."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return float("nan")
        if self.ideal is not None or not self.figure.is_ratio or not (finite > 0.0).all():
            return float(finite.mean())
        return float(np.exp(np.log(finite).mean()))

    def difference(self, a: FloatArray, b: FloatArray, *, paired: bool = True, comparisons: int = 1) -> Difference:
        """Difference by which a is worse than b, from their values in each run (NaN where unknown).

        Of a measure of consistency: how much farther a's mean is from the ideal, as a factor. `paired`: whether a run
        of a and the same one of b had the same measurements; `comparisons`: made at once.
        """
        if not paired:
            return unpaired_difference(self._badness(a), self._badness(b), comparisons=comparisons)
        if self.figure.larger_is_better:
            return paired_difference(b, a, comparisons=comparisons)
        if self.ideal is None:
            return paired_difference(a, b, comparisons=comparisons, is_ratio=self.figure.is_ratio)
        both = np.isfinite(a) & np.isfinite(b) & (a > 0.0) & (b > 0.0)
        return difference_of(_deviation(a[both]) - _deviation(b[both]), comparisons=comparisons)

    def _badness(self, values: FloatArray) -> FloatArray:
        """Values whose ratio says how much worse one is."""
        if self.figure.larger_is_better:
            return np.asarray(1.0 / values)
        if self.ideal is None:
            return values
        return np.asarray(np.exp(_deviation(values[np.isfinite(values) & (values > 0.0)])))


def _deviation(values: FloatArray) -> FloatArray:
    """Share of each run in |log(mean)|, how far the mean is from 1: their mean is exactly that.

    The logarithm of the mean, linear in each value (the delta method). |log| of each run instead would count the
    scatter of single runs, which a consistent filter has, too.
    """
    mean = values.mean() if values.size else 1.0
    return np.asarray(np.copysign(1.0, np.log(mean)) * (np.log(mean) + values / mean - 1.0))


MEASURES = tuple(Measure(figure) for figure in FIGURES.values() if figure.compared)
POSITION, ROTATION, POSE_NEES, EFFICIENCY, TIME, FINAL_SIGMA, FINAL_LOGDET, FINAL_ERROR, DIVERGED = (
    Measure(FIGURES[name])
    for name in (
        *("position_rmse_m", "rotation_rmse_deg", "pose_anees", "efficiency_percent"),
        *("ms_per_frame", "final_position_sigma_m", "final_pose_logdet", "end_error_m", "diverged"),
    )
)
QUESTIONS = (POSITION, ROTATION, POSE_NEES, TIME)
"""Measures that the filters of one run are compared by: accuracy, consistency, cost."""
CLAIM_AND_TRUTH = (FINAL_SIGMA, FINAL_LOGDET, FINAL_ERROR, POSITION, ROTATION, POSE_NEES)
"""Measures that policies are compared by: the claimed uncertainty at the end, and the true errors."""


# ---- pairs ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PairVerdict:
    """One filter against another one, by one measure."""

    measure: Measure
    filter_name: str
    against: str
    difference: Difference  # of the measure; for consistency, of the distance from the ideal
    words: str  # "12 % smaller (−15 to −9 % at 95 % confidence, 10 paired runs)", or that no difference is shown

    @property
    def finding(self) -> Finding:
        """Whether the filter is shown to be better or worse than the other one."""
        return self.difference.finding


@dataclass(frozen=True)
class PairwiseTable:
    """Each filter against each other one, or all against a baseline."""

    filters: tuple[str, ...]  # in the order of the summaries
    measures: tuple[Measure, ...]  # those that some pair could be compared by
    cells: Mapping[tuple[str, str, str], PairVerdict]  # both directions of every pair

    def cell(self, measure: Measure, filter_name: str, against: str) -> PairVerdict | None:
        """The verdict on `filter_name`; None where the two were not compared."""
        return self.cells.get((measure.key, filter_name, against))


def compare_all(
    summaries: Sequence[FilterSummary],
    figures: Figures,
    *,
    baseline: str | None = None,
    measures: Sequence[Measure] = QUESTIONS,
) -> PairwiseTable:
    """Compare each filter with each other one, or all with a baseline, question by question.

    Intervals and tests are corrected for the number of pairs; each measure stands for itself.

    Raises
    ------
    ValueError
        There is no such baseline.
    """
    names = tuple(s.filter_name for s in summaries)
    if baseline is not None and baseline not in names:
        raise ValueError(f"baseline must be one of {', '.join(names)}, got {baseline!r}")
    pairs = [(a, b) for a, b in combinations(names, 2) if baseline in (None, a, b)]
    cells: dict[tuple[str, str, str], PairVerdict] = {}
    for measure in measures:
        for a, b in pairs:
            keys = common_keys(figures[a], figures[b])
            values = (measure.by_run(figures[name], keys) for name in (a, b))
            difference = measure.difference(*values, comparisons=len(pairs))
            if difference.count:
                cells[measure.key, a, b] = _pair_verdict(measure, a, b, difference)
                cells[measure.key, b, a] = _pair_verdict(measure, b, a, difference.reversed)
    known = {key for key, _, _ in cells}
    return PairwiseTable(names, tuple(m for m in measures if m.key in known), cells)


def change_words(measure: Measure, difference: Difference) -> str:
    """A difference of a measure in words, with its evidence in brackets."""
    if difference.tied:
        return difference.tie_words
    if not difference.shown:
        return f"{Finding.NOT_SHOWN.value} ({difference.evidence})"
    if measure.ideal is not None:
        nearer = "nearer to" if difference.estimate < 0.0 else "farther from"
        return f"{nearer} its ideal ({difference.evidence})"
    if not measure.figure.is_ratio:
        more = "less" if difference.estimate < 0.0 else "more"
        return f"{abs(difference.estimate):.3g} {more} ({difference.evidence})"
    found = difference.reversed if measure.figure.larger_is_better else difference
    return f"{percent_words(found.percent)} ({found.evidence})"


def finding_words(measure: Measure, difference: Difference) -> str:
    """Finding and change in words: "worse: 12 % larger (+9 to +15 % ...)", "no difference shown (...)"."""
    words = change_words(measure, difference)
    return f"{difference.finding.value}: {words}" if difference.shown else words


def _pair_verdict(measure: Measure, a: str, b: str, difference: Difference) -> PairVerdict:
    return PairVerdict(measure, a, b, difference, change_words(measure, difference))
