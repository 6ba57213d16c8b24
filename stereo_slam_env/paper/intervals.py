"""95 % confidence intervals of what is measured."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import binomtest
from scipy.stats import t as student

from filters.validation import FloatArray
from stereo_slam_env.paper.claims import Interval

CONFIDENCE = 0.95
MIN_RUNS = 5
"""With fewer independent runs there is no interval worth the name."""


def share_interval(hits: int, trials: int) -> Interval:
    """A share of independent trials (Clopper and Pearson)."""
    bounds = binomtest(hits, trials).proportion_ci(CONFIDENCE, "exact")
    return Interval(hits / trials, float(bounds.low), float(bounds.high))


def mean_interval(values: FloatArray) -> Interval:
    """The mean of independent runs (Student); values that are not finite are left out."""
    finite = values[np.isfinite(values)]
    if len(finite) < MIN_RUNS:
        return Interval(float(finite.mean()) if len(finite) else math.nan, math.nan, math.nan)
    half = float(student.ppf(0.5 + 0.5 * CONFIDENCE, len(finite) - 1) * finite.std(ddof=1) / np.sqrt(len(finite)))
    mean = float(finite.mean())
    return Interval(mean, mean - half, mean + half)


def rms_interval(values: FloatArray) -> Interval:
    """The root mean square over independent runs."""
    square = mean_interval(np.square(values))
    return Interval(*(math.sqrt(max(x, 0.0)) for x in (square.value, square.low, square.high)))


def ratio_interval(ours: FloatArray, theirs: FloatArray) -> Interval:
    """How many times theirs ours is: geometric mean of the ratios of paired runs.

    Parameters
    ----------
    ours, theirs : (N,) array
        Positive quantities of the same recordings; pairs that are not are left out.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = mean_interval(np.log(np.asarray(ours) / np.asarray(theirs)))
    return Interval(*(math.exp(x) for x in (logs.value, logs.low, logs.high)))
