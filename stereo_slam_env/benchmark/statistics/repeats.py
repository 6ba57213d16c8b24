"""Systems that are not deterministic: several runs on each recording, labelled NAME+1, NAME+2 and so on.

Runs of one system on one recording are no independent sample: they share what is hard in it. Of each recording the mean
over runs counts, geometric of errors and arithmetic of NEES, and the recordings are the sample. Their scatter holds
both factors: that of recordings, and that of runs divided by their number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.statistics.differences import Difference
from stereo_slam_env.benchmark.statistics.measures import POSITION, QUESTIONS, PairwiseTable, difference_by
from stereo_slam_env.evaluation.figures import Figure
from stereo_slam_env.evaluation.run_figures import Figures, RunFigures, RunKey

_RUN = re.compile(r"(.+)\+\d+")


def systems(labels: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Labels of the runs of each system, in order; one that is run once has its own label."""
    found: dict[str, list[str]] = {}
    for label in labels:
        run = _RUN.fullmatch(label)
        found.setdefault(label if run is None else run[1], []).append(label)
    return {name: tuple(runs) for name, runs in found.items()}


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
            found = difference_by(measure, ours, theirs, comparisons=len(pairs))
            if found.count:
                cells[measure.name, a, b], cells[measure.name, b, a] = found, found.reversed
    known = {name for name, _, _ in cells}
    return PairwiseTable(tuple(runs), tuple(m for m in measures if m.name in known), cells)


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
