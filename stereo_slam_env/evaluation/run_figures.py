"""Figures of every run of every filter, computed once, where the run is, and their summary over runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation.comparability import doubt_of_runs
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.figures import FIGURES, Figure, has_diverged, trial_figures
from stereo_slam_env.evaluation.landmark_statistics import depth_convergence, range_errors
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary, SegmentError
from stereo_slam_env.evaluation.trajectory_metrics import SegmentErrors
from stereo_slam_env.evaluation.trial import Sample, Trial

RunKey = tuple[str, int | None]
"""Identity of a recording: its name and seed."""

Bounds = Mapping[RunKey, Bound]
"""Theoretical limits of recordings."""


@dataclass(frozen=True)
class RunFigures:
    """Figures of every run of a filter."""

    of_run: Mapping[RunKey, Mapping[str, Any]]  # of each run alone, see `trial_figures`; None where not known
    segments: Mapping[RunKey, SegmentErrors] = field(default_factory=dict)  # relative errors of each run

    def values(self, figure: Figure, keys: Iterable[RunKey]) -> FloatArray:
        """A figure in the runs on these recordings, as tables show it; NaN where not known."""
        return np.array([figure.of(self.of_run[key]) for key in keys])

    def diverged(self, keys: Iterable[RunKey]) -> BoolArray:
        """Whether each run diverged or failed."""
        return np.array([self.of_run[key]["diverged"] > 0 for key in keys], dtype=bool)


Figures = Mapping[str, RunFigures]
"""By label of the filter."""


@dataclass(frozen=True)
class RunScore:
    """Figures of one run, as they are kept with it."""

    figures: Mapping[str, Any]  # see `trial_figures`
    segments: SegmentErrors

    def judged(self, divergence_percent: float) -> RunScore:
        """The same with another limit of divergence, which is one of the report and not of the run."""
        return replace(self, figures={**self.figures, "diverged": has_diverged(self.figures, divergence_percent)})


def score_of(run: FilterRun, *, divergence_percent: float, bound: Bound | None = None) -> RunScore:
    """Figures of a run; arguments and errors as of `figures_of`."""
    trial = Trial(run, divergence_percent, bound)
    return RunScore(trial_figures(trial), trial.segments)


def key_of(run: FilterRun) -> RunKey:
    """The recording of a run."""
    return run.recording_name, run.seed


def common_keys(a: RunFigures, b: RunFigures) -> list[RunKey]:
    """Recordings that both were run on, in the order of `a`."""
    return [key for key in a.of_run if key in b.of_run]


def figures_of(
    runs: Sequence[FilterRun], *, divergence_percent: float, bounds: Bounds | None = None
) -> dict[str, RunFigures]:
    """Figures of every run, by label of the filter, in order of first appearance.

    Parameters
    ----------
    runs : sequence of FilterRun
        Of any filters, each recording once.
    divergence_percent : float
        A run diverged if it ends farther from the truth than this share of the distance travelled: that of the
        scenario, so there is no default.
    bounds : mapping, optional
        Theoretical limits of the recordings, as far as they are known.

    Raises
    ------
    ValueError
        A filter ran twice on the same recording, or a bound is of another number of frames than the run.
    """
    scores: dict[str, dict[RunKey, RunScore]] = {}
    for run in runs:
        of_filter, key = scores.setdefault(run.filter_name, {}), key_of(run)
        if key in of_filter:
            raise ValueError(f"runs must have each recording once a filter: {run.filter_name} ran twice on {key}")
        of_filter[key] = score_of(run, divergence_percent=divergence_percent, bound=(bounds or {}).get(key))
    return {name: together(of_filter) for name, of_filter in scores.items()}


def together(scores: Mapping[RunKey, RunScore]) -> RunFigures:
    """Figures of all runs of a filter from those of each."""
    return RunFigures(
        {key: score.figures for key, score in scores.items()}, {key: score.segments for key, score in scores.items()}
    )


def summarise_all(runs: Sequence[FilterRun], figures: Figures) -> tuple[FilterSummary, ...]:
    """One summary a filter, in order of first appearance; `figures` are those of the same runs."""
    by_filter: dict[str, list[FilterRun]] = {}
    for run in runs:
        by_filter.setdefault(run.filter_name, []).append(run)
    return tuple(summarise(group, figures[name]) for name, group in by_filter.items())


def summarise(runs: Sequence[FilterRun], figures: RunFigures) -> FilterSummary:
    """Figures of one filter over its runs, one a seed; `figures` are those of the same runs.

    A run that failed counts as diverged and has no part in the other figures but the event counts; one that diverged
    with finite numbers has.

    Raises
    ------
    ValueError
        No runs, or runs of different filters.
    """
    names = sorted({run.filter_name for run in runs})
    if len(names) != 1:
        raise ValueError(f"runs must hold at least one run, and be of one filter, got {', '.join(names) or 'none'}")
    keys = [key_of(run) for run in runs]
    segments = SegmentErrors.together([figures.segments[key] for key in keys])
    sample = Sample(runs, [figures.of_run[key] for key in keys], segments)
    over_runs = {
        f.name: f.over_runs.of(sample, f.name)
        for f in FIGURES.values()
        if f.over_runs is not None and (not f.is_optional or any(f.name in row for row in sample.rows))
    }
    pose, statistics = sample.consistency.get("pose"), [run.landmark_statistics for run in sample.completed]
    bounded = len(sample.known("efficiency_percent")) > 0
    return FilterSummary(
        filter_name=names[0],
        options=runs[0].options,
        runs=len(runs),
        figures=over_runs,
        position_rmse_by_run=tuple(sample.column("position_rmse_m").tolist()),
        efficiency_by_run=tuple(sample.column("efficiency_percent").tolist()) if bounded else (),
        pose_anees_band=None if pose is None else pose.band,
        consistency=sample.consistency,
        doubt=doubt_of_runs(sample.completed, sample.consistency),
        rpe=_by_length(segments),
        landmark_by_range=range_errors(statistics),
        depth_convergence=depth_convergence(statistics),
        failures=tuple(
            run.failure if run.seed is None else f"seed {run.seed}, {run.failure}"
            for run in runs
            if run.failure is not None
        ),
        not_given=next((run.not_given for run in runs if run.not_given), {}),
    )


def _by_length(relative: SegmentErrors) -> tuple[SegmentError, ...]:
    """Means over the segments of each length, ascending."""
    lengths, which, counts = np.unique(relative.lengths, return_inverse=True, return_counts=True)
    translation, rotation = (
        np.bincount(which, weights=values, minlength=len(lengths)) / counts
        for values in (relative.translation_percent, relative.rotation_deg_per_100m)
    )
    return tuple(
        SegmentError(*row)
        for row in zip(lengths.tolist(), counts.tolist(), translation.tolist(), rotation.tolist(), strict=True)
    )
