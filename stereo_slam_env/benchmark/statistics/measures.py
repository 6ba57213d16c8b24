"""Measures: figures that filters are compared by, and the comparison of each filter with each other one.

A measure is an entry of the table of figures. Its values are those that tables show: divided by the ideal, where there
is one, so that a consistent filter has 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.statistics.differences import (
    Difference,
    Finding,
    difference_of,
    paired_difference,
    percent_words,
    unpaired_difference,
)
from stereo_slam_env.evaluation.figures import FIGURES, Figure, readable
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures, RunFigures, common_keys

MEASURES = tuple(figure for figure in FIGURES.values() if figure.compared)
POSITION, ROTATION, POSE_NEES, EFFICIENCY, TIME, FINAL_SIGMA, FINAL_LOGDET, FINAL_ERROR, DIVERGED = (
    FIGURES[name]
    for name in (
        *("position_rmse_m", "rotation_rmse_deg", "pose_anees", "efficiency_percent"),
        *("ms_per_frame", "final_position_sigma_m", "final_pose_logdet", "end_error_m", "diverged"),
    )
)
QUESTIONS = (POSITION, ROTATION, POSE_NEES, TIME)
"""Measures that the filters of one run are compared by: accuracy, consistency, cost."""
CLAIM_AND_TRUTH = (FINAL_SIGMA, FINAL_LOGDET, FINAL_ERROR, POSITION, ROTATION, POSE_NEES)
"""Measures that policies are compared by: the claimed uncertainty at the end, and the true errors."""


def difference_by(
    measure: Figure, a: FloatArray, b: FloatArray, *, paired: bool = True, comparisons: int = 1
) -> Difference:
    """Difference by which a is worse than b, from the values of a measure in each run (NaN where unknown).

    Of a measure of consistency: how much farther a's mean is from the ideal, as a factor. `paired`: whether a run of a
    and the same one of b had the same measurements; `comparisons`: made at once.
    """
    if not paired:
        return unpaired_difference(_badness(measure, a), _badness(measure, b), comparisons=comparisons)
    if measure.larger_is_better:
        return paired_difference(b, a, comparisons=comparisons)
    if measure.ideal is None:
        return paired_difference(a, b, comparisons=comparisons, is_ratio=measure.is_ratio)
    both = np.isfinite(a) & np.isfinite(b) & (a > 0.0) & (b > 0.0)
    return difference_of(_deviation(a[both]) - _deviation(b[both]), comparisons=comparisons)


def difference_between(a: RunFigures, b: RunFigures, measure: Figure, comparisons: int = 1) -> Difference:
    """Difference by which filter a is worse than b, on the recordings that both were run on."""
    keys = common_keys(a, b)
    return difference_by(measure, a.values(measure, keys), b.values(measure, keys), comparisons=comparisons)


def _badness(measure: Figure, values: FloatArray) -> FloatArray:
    """Values whose ratio says how much worse one is."""
    if measure.larger_is_better:
        return np.asarray(1.0 / values)
    if measure.ideal is None:
        return values
    return np.asarray(np.exp(_deviation(values[np.isfinite(values) & (values > 0.0)])))


def _deviation(values: FloatArray) -> FloatArray:
    """Share of each run in |log(mean)|, how far the mean is from 1: their mean is exactly that.

    The logarithm of the mean, linear in each value (the delta method). |log| of each run instead would count the
    scatter of single runs, which a consistent filter has, too.
    """
    mean = values.mean() if values.size else 1.0
    return np.asarray(np.copysign(1.0, np.log(mean)) * (np.log(mean) + values / mean - 1.0))


# ---- pairs ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PairwiseTable:
    """Each filter against each other one, or all against a baseline."""

    filters: tuple[str, ...]  # in the order of the summaries
    measures: tuple[Figure, ...]  # those that some pair could be compared by
    cells: Mapping[tuple[str, str, str], Difference]  # by measure, filter and the other one: both directions

    def cell(self, measure: Figure, filter_name: str, against: str) -> Difference | None:
        """Difference by which `filter_name` is worse; None where the two were not compared."""
        return self.cells.get((measure.name, filter_name, against))


def compare_all(
    summaries: Sequence[FilterSummary],
    figures: Figures,
    *,
    baseline: str | None = None,
    measures: Sequence[Figure] = QUESTIONS,
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
    cells: dict[tuple[str, str, str], Difference] = {}
    for measure in measures:
        for a, b in pairs:
            found = difference_between(figures[a], figures[b], measure, len(pairs))
            if found.count:
                cells[measure.name, a, b], cells[measure.name, b, a] = found, found.reversed
    known = {name for name, _, _ in cells}
    return PairwiseTable(names, tuple(m for m in measures if m.name in known), cells)


def change_words(measure: Figure, difference: Difference) -> str:
    """A difference of a measure, run by run, in words with its evidence: "12 % smaller (−15 to −9 % at ...)"."""
    if difference.tied:
        return difference.tie_words
    if not difference.shown:
        return f"{Finding.NOT_SHOWN.value} ({difference.evidence})"
    if measure.ideal is not None:
        nearer = "nearer to" if difference.estimate < 0.0 else "farther from"
        return f"{nearer} its ideal ({difference.evidence})"
    if not measure.is_ratio:
        more = "less" if difference.estimate < 0.0 else "more"
        return f"{readable(abs(difference.estimate))} {more} ({difference.evidence})"
    found = difference.reversed if measure.larger_is_better else difference
    return f"{percent_words(found.percent)} ({found.evidence})"
