"""Errors of the map by range and by age, put together over the runs of a filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.evaluation.landmark_statistics import AGES, DEPTH_CLASSES, RANGE_EDGES, LandmarkStatistics
from stereo_slam_env.evaluation.results import DepthConvergence, RangeError


def range_errors(runs: Sequence[LandmarkStatistics]) -> tuple[RangeError, ...]:
    """One figure for each range in which there was a landmark, ascending; NaN for what nothing is known of."""
    total = LandmarkStatistics.total(runs)
    with np.errstate(divide="ignore", invalid="ignore"):
        rmse = np.sqrt(total.squared_error / total.position_count)
        bias = total.depth_error / total.position_count
        anees = total.nees / total.nees_count
    sigma = _standard_error([run.depth_error for run in runs], [run.position_count for run in runs], bias)
    return tuple(
        RangeError(
            low_m=RANGE_EDGES[i],
            high_m=RANGE_EDGES[i + 1],
            count=int(total.nees_count[i]),
            rmse_m=float(rmse[i]),
            depth_bias_m=float(bias[i]),
            depth_bias_sigma_m=float(sigma[i]),
            anees=float(anees[i]),
        )
        for i in np.flatnonzero(total.nees_count)
    )


def depth_convergence(runs: Sequence[LandmarkStatistics]) -> tuple[DepthConvergence, ...]:
    """The curves of the classes of which landmarks were seen: near, then far."""
    total = LandmarkStatistics.total(runs)
    curves = []
    for (label, (low, high)), count, variance, square in zip(
        DEPTH_CLASSES.items(), total.age_count, total.depth_variance, total.squared_depth_error, strict=True
    ):
        ages = np.arange(AGES)[count > 0]
        if not len(ages):
            continue
        curves.append(
            DepthConvergence(
                label=label,
                low_m=low,
                high_m=high,
                frames=tuple(ages.tolist()),
                count=tuple(count[ages].astype(int).tolist()),
                sigma_m=tuple(np.sqrt(variance[ages] / count[ages]).tolist()),
                rmse_m=tuple(np.sqrt(square[ages] / count[ages]).tolist()),
            )
        )
    return tuple(curves)


def _standard_error(sums: Sequence[FloatArray], counts: Sequence[FloatArray], mean: FloatArray) -> FloatArray:
    """Of a mean (B,) over all runs, sum of their sums over sum of their counts: runs are independent, landmarks not.

    Source: ratio estimator, Cochran, Sampling Techniques, 1977, section 6.4. NaN for a single run.
    """
    n = np.reshape(counts, (-1, len(mean)))
    runs = (n > 0).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        scatter = np.sum(np.square(np.reshape(sums, n.shape) - mean * n), axis=0)
        error: FloatArray = np.sqrt(scatter * runs / (runs - 1)) / n.sum(axis=0)
    return np.where(runs > 1, error, np.nan)
