"""Measures: figures that filters are compared by, and the comparison of each filter with each other one.

A measure is an entry of the table of figures. Its values are those that tables show: divided by the ideal, where there
is one, so that a consistent filter has 1.

Systems that are not deterministic: several runs on each recording, labelled NAME+1, NAME+2 and so on.

Runs of one system on one recording are no independent sample: they share what is hard in it. Of each recording the mean
over runs counts, geometric of errors and arithmetic of NEES, and the recordings are the sample. Their scatter holds
both factors: that of recordings, and that of runs divided by their number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.statistics.differences import (
    Difference,
    difference_of,
    paired_difference,
    unpaired_difference,
)
from stereo_slam_env.evaluation.bands import DOF
from stereo_slam_env.evaluation.figures import FIGURES, UNKNOWN, Figure
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures, RunFigures, RunKey, common_keys

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
            difference = difference_between(figures[a], figures[b], measure, len(pairs))
            if difference.count:
                cells[measure.name, a, b], cells[measure.name, b, a] = difference, difference.reversed
    known_names = {name for name, _, _ in cells}
    return PairwiseTable(names, tuple(m for m in measures if m.name in known_names), cells)


def pose_nees(summary: FilterSummary) -> tuple[str, str]:
    """Mean pose NEES and its band, both by the degrees of freedom, so that 1 is ideal: "0.85", "0.37 to 1.94"."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return UNKNOWN, UNKNOWN
    low, high = (end / DOF["pose"] for end in summary.pose_anees_band)
    return POSE_NEES.text(summary.pose_anees), f"{low:.2f} to {high:.2f}"


_RUN = re.compile(r"(.+)\+\d+")


def systems(labels: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Labels of the runs of each system, in order; one that is run once has its own label."""
    systems_by_label: dict[str, list[str]] = {}
    for label in labels:
        run = _RUN.fullmatch(label)
        systems_by_label.setdefault(label if run is None else run[1], []).append(label)
    return {name: tuple(runs) for name, runs in systems_by_label.items()}


def compare_systems(figures: Figures, *, measures: Sequence[Figure] = QUESTIONS) -> PairwiseTable | None:
    """Compare each system with each other one, over runs and recordings; None where none is run several times.

    Intervals and tests are corrected for the number of pairs.
    """
    runs = systems(list(figures))
    if len(runs) == len(figures):
        return None
    pairs, cells = list(combinations(runs, 2)), dict[tuple[str, str, str], Difference]()
    for measure in measures:
        means = {name: _means([figures[label] for label in labels], measure) for name, labels in runs.items()}
        for a, b in pairs:
            keys = [key for key in means[a] if key in means[b]]
            ours, theirs = (np.array([means[name][key] for key in keys]) for name in (a, b))
            difference = difference_by(measure, ours, theirs, comparisons=len(pairs))
            if difference.count:
                cells[measure.name, a, b], cells[measure.name, b, a] = difference, difference.reversed
    known_names = {name for name, _, _ in cells}
    return PairwiseTable(tuple(runs), tuple(m for m in measures if m.name in known_names), cells)


def run_spread(figures: Figures, labels: Sequence[str], measure: Figure = POSITION) -> float:
    """Standard deviation of log(value) between runs on the same recording, pooled; NaN without two runs of one."""
    squares, freedom = 0.0, 0
    for values in _values([figures[label] for label in labels], measure).values():
        logs = np.log(values[np.isfinite(values) & (values > 0.0)])
        if len(logs) > 1:
            squares, freedom = squares + float(np.sum((logs - logs.mean()) ** 2)), freedom + len(logs) - 1
    return float(np.sqrt(squares / freedom)) if freedom else float("nan")


def _values(runs: Sequence[RunFigures], measure: Figure) -> dict[RunKey, FloatArray]:
    """The measure in each run, by recording."""
    keys = dict.fromkeys(key for run in runs for key in run.of_run)
    return {key: np.array([measure.of(run.of_run[key]) for run in runs if key in run.of_run]) for key in keys}


def _means(runs: Sequence[RunFigures], measure: Figure) -> Mapping[RunKey, float]:
    """The mean over runs of each recording; NaN where one is not known."""
    found = _values(runs, measure)
    if measure.ideal is not None or not measure.is_ratio:
        return {key: float(values.mean()) for key, values in found.items()}
    with np.errstate(divide="ignore", invalid="ignore"):
        return {key: float(np.exp(np.log(values).mean())) for key, values in found.items()}
