"""95 % confidence intervals of what is measured, by the benchmark's differences."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import binomtest

from filters.validation import FloatArray
from stereo_slam_env.benchmark.statistics import differences
from stereo_slam_env.benchmark.statistics.differences import CONFIDENCE, MIN_PAIRS
from stereo_slam_env.studies.paper.claims import Interval


def share_interval(hits: int, trials: int) -> Interval:
    """A share of independent trials (Clopper and Pearson)."""
    bounds = binomtest(hits, trials).proportion_ci(CONFIDENCE, "exact")
    return Interval(hits / trials, float(bounds.low), float(bounds.high))


def mean_interval(values: FloatArray) -> Interval:
    """The mean of independent runs; values that are not finite are left out."""
    finite = values[np.isfinite(values)]
    if len(finite) < MIN_PAIRS:
        return Interval(float(finite.mean()) if len(finite) else math.nan, math.nan, math.nan)
    low, high = differences.mean_interval(finite[:, None], CONFIDENCE)
    return Interval(float(finite.mean()), float(low[0]), float(high[0]))


def rms_interval(values: FloatArray) -> Interval:
    """The root mean square over independent runs."""
    square = mean_interval(np.square(values))
    return Interval(*(math.sqrt(max(x, 0.0)) for x in (square.value, square.low, square.high)))


def ratio_interval(ours: FloatArray, theirs: FloatArray) -> Interval:
    """How many times theirs ours is: geometric mean over paired runs.

    Parameters
    ----------
    ours, theirs : (N,) array
        Positive quantities of the same recordings; pairs that are not are left out.
    """
    difference = differences.paired_difference(ours, theirs)
    low, high = difference.interval or (math.nan, math.nan)
    return Interval(*(math.exp(x) for x in (difference.estimate, low, high)))
