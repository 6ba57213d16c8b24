"""Chi-square bands of NEES and NIS (Bar-Shalom, Li and Kirubarajan, 2001, section 5.4)."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from filters.validation import FloatArray, IntArray


def mean_band(dof: float, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided band of the mean of `runs` independent chi-square variables of `dof` degrees of freedom.

    A consistent filter is inside with this probability; the sum over N runs is chi-square with N * dof degrees of
    freedom.

    Raises
    ------
    ValueError
        dof or runs is not positive, or probability is not between 0 and 1.
    """
    if not dof > 0:
        raise ValueError(f"dof must be > 0, got {dof!r}")
    if not runs >= 1:
        raise ValueError(f"runs must be >= 1, got {runs!r}")
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability must be between 0 and 1, got {probability!r}")
    low, high = mean_bands(dof, np.array(runs), probability)
    return float(low), float(high)


def mean_bands(dof: float, runs: IntArray | FloatArray, probability: float = 0.95) -> tuple[FloatArray, FloatArray]:
    """`mean_band` for many numbers of runs (K,) at once, unchecked: low and high (K,)."""
    tail = 0.5 * (1.0 - probability)
    return chi2.ppf(tail, runs * dof) / runs, chi2.ppf(1.0 - tail, runs * dof) / runs


def share_inside(values: FloatArray, band: tuple[float, float]) -> float:
    """Share of the finite `values` inside `band`, 0 to 1; NaN where none is finite."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return float("nan")
    return float(np.mean((finite >= band[0]) & (finite <= band[1])))
