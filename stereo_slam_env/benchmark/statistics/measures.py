"""What filters are compared by: each measure, of one run and of many, and how far a value is from the best possible."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.benchmark.statistics.differences import (
    Difference,
    difference_of,
    paired_difference,
    unpaired_difference,
)
from stereo_slam_env.evaluation.consistency_figures import DOF, LANDMARK_DOF
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import RunFigures, RunKey


@dataclass(frozen=True)
class Measure:
    """A figure that filters are compared by.

    Attributes
    ----------
    key : str
        Name of the figure of a run, and of the field of `FilterSummary`.
    words : str
        What it is called: "position error".
    unit : str
        For a value; may be empty.
    scale : float
        A value is the field times this.
    ideal : float, optional
        Of a measure of consistency, the value of a filter that knows how wrong it is; None: the smaller the better.
    larger_is_better : bool
        Whether it is an efficiency.
    is_ratio : bool
        Whether values are compared by their ratio; False: by their difference, because they are logarithms already.
    """

    key: str
    words: str
    unit: str = ""
    scale: float = 1.0
    ideal: float | None = None
    larger_is_better: bool = False
    is_ratio: bool = True

    def of(self, figures: FilterSummary | Mapping[str, Any]) -> float:
        """The value in a summary or in the figures of a run; NaN where it is not known."""
        value = figures.get(self.key) if isinstance(figures, Mapping) else getattr(figures, self.key)
        return float("nan") if value is None else self.scale * float(value)

    def by_run(self, figures: RunFigures, keys: Iterable[RunKey]) -> FloatArray:
        """The values in the runs on these recordings, in this order; NaN where not known."""
        return np.array([self.of(figures.of_run[key]) for key in keys])

    def over_runs(self, values: FloatArray) -> float:
        """One value for many runs: their geometric mean; of consistency and logarithms their mean; NaN without any."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return float("nan")
        if self.ideal is not None or not self.is_ratio or not (finite > 0.0).all():
            return float(finite.mean())
        return float(np.exp(np.log(finite).mean()))

    def difference(self, a: FloatArray, b: FloatArray, *, paired: bool = True, comparisons: int = 1) -> Difference:
        """How much worse a is than b, from the values of both in each run.

        Of a measure of consistency: how much farther a's mean is from the ideal, as a factor.

        Parameters
        ----------
        a, b : (n,) ndarray
            Run by run; NaN where not known.
        paired : bool
            Whether a run of a and the same one of b had the same measurements.
        comparisons : int
            Made at once.
        """
        if not paired:
            worse = (_badness_unpaired(a, self), _badness_unpaired(b, self))
            return unpaired_difference(*worse, comparisons=comparisons)
        if self.larger_is_better:
            return paired_difference(b, a, comparisons=comparisons)
        if self.ideal is None:
            return paired_difference(a, b, comparisons=comparisons, is_ratio=self.is_ratio)
        both = np.isfinite(a) & np.isfinite(b) & (a > 0.0) & (b > 0.0)
        gaps = _deviation(a[both] / self.ideal) - _deviation(b[both] / self.ideal)
        return difference_of(gaps, comparisons=comparisons)


POSITION = Measure("position_rmse_m", "position error", "m")
ROTATION = Measure("rotation_rmse_deg", "rotation error", "°")
ATE = Measure("ate_rigid_m", "error after alignment", "m")
LANDMARKS = Measure("landmark_rmse_m", "landmark error", "m")
POSE_NEES = Measure("pose_anees", "pose NEES / 6", scale=1.0 / DOF["pose"], ideal=1.0)
LANDMARK_NEES = Measure("landmark_anees", "landmark NEES / 3", scale=1.0 / LANDMARK_DOF, ideal=1.0)
NIS = Measure("nis", "NIS / dof", ideal=1.0)
EFFICIENCY = Measure("efficiency_percent", "efficiency", "%", larger_is_better=True)
TIME = Measure("ms_per_frame", "time", "ms")
FINAL_SIGMA = Measure("final_position_sigma_m", "claimed σ of the final position", "m")
FINAL_LOGDET = Measure("final_pose_logdet", "log det of the final pose covariance", is_ratio=False)
FINAL_ERROR = Measure("end_error_m", "final position error", "m")

MEASURES = (POSITION, ROTATION, ATE, LANDMARKS, POSE_NEES, NIS, EFFICIENCY, TIME)
QUESTIONS = (POSITION, ROTATION, POSE_NEES, TIME)
"""What filters of one run are compared by: how accurate, how honest, how fast."""
CLAIM_AND_TRUTH = (FINAL_SIGMA, FINAL_LOGDET, FINAL_ERROR, POSITION, ROTATION, POSE_NEES)
"""What policies are compared by: what their filters claim in the end, and what is true."""


def _deviation(values: FloatArray) -> FloatArray:
    """Share of each run in |log(mean)|, how far the mean is from 1: their mean is exactly that.

    The logarithm of the mean, linear in each value (the delta method). |log| of each run instead would count the
    scatter of single runs, which a consistent filter has, too.
    """
    mean = values.mean() if values.size else 1.0
    return np.asarray(np.copysign(1.0, np.log(mean)) * (np.log(mean) + values / mean - 1.0))


def _badness_unpaired(values: FloatArray, measure: Measure) -> FloatArray:
    if measure.larger_is_better:
        return np.asarray(1.0 / values)
    if measure.ideal is None:
        return values
    known = values[np.isfinite(values) & (values > 0.0)]
    return np.asarray(np.exp(_deviation(known / measure.ideal)))
