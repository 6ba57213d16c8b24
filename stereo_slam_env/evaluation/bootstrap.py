"""Stationary block bootstrap: the uncertainty of a mean over the frames of one run, which are correlated.

References
----------
Politis and Romano, "The stationary bootstrap", JASA 89(428), 1994. Politis and White, "Automatic block-length selection
for the dependent bootstrap", Econometric Reviews 23(1), 2004.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.validation import FloatArray, IntArray

RESAMPLES = 2000
FEWEST = 8  # values below which the length of a block is not estimated
_CALM = 5  # lags in a row without correlation that end the search for it


@dataclass(frozen=True)
class MeanInterval:
    """Mean of a series with its 95 % interval."""

    mean: float
    low: float
    high: float
    block: float  # mean length of a block, values

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


def mean_interval(values: FloatArray, confidence: float = 0.95) -> MeanInterval:
    """Mean of a correlated series (K,) with its interval by percentiles of the bootstrap, seeded; NaN of none.

    A series that is not much longer than it is correlated, such as the NEES of one short drive, has an interval that is
    too narrow: no resampling knows what the run did not show.
    """
    if not len(values):
        return MeanInterval(*[float("nan")] * 4)
    block = block_length(values)
    drawn = values[stationary_rows(len(values), block, np.random.default_rng(0))].mean(axis=1)
    low, high = np.quantile(drawn, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    return MeanInterval(float(values.mean()), float(low), float(high), block)


def block_length(values: FloatArray) -> float:
    """Mean length of a block for the stationary bootstrap of a series (K,), by Politis and White; from 1 to K.

    1 where there is no correlation to be seen: fewer than `FEWEST` values, or all the same.
    """
    count = len(values)
    if count < FEWEST or np.ptp(values) <= 1e-12 * max(1.0, float(np.abs(values).max())):
        return 1.0
    centred = values - values.mean()
    longest = max(_CALM + 1, min(int(np.ceil(np.sqrt(count))) + _CALM, count - 1))
    covariance = np.array([centred[: count - lag] @ centred[lag:] / count for lag in range(longest + 1)])
    small = np.abs(covariance / covariance[0]) < 2.0 * np.sqrt(np.log10(count) / count)
    calm = (lag for lag in range(1, longest - _CALM + 2) if small[lag : lag + _CALM].all())
    last = next(calm, max(1, longest // 2))
    width = min(max(2 * last, 2), longest)
    lags = np.arange(-width, width + 1)
    window = np.clip(2.0 * (1.0 - np.abs(lags) / width), 0.0, 1.0)  # flat up to the half, then falling to nothing
    spectrum = float(window @ covariance[np.abs(lags)])
    slope = float((window * np.abs(lags)) @ covariance[np.abs(lags)])
    if spectrum <= 0.0 or slope <= 0.0:
        return 1.0
    return float(np.clip((slope**2 / spectrum**2 * count) ** (1.0 / 3.0), 1.0, count))


def stationary_rows(count: int, block: float, generator: np.random.Generator, resamples: int = RESAMPLES) -> IntArray:
    """Rows of each resample, (resamples, count): blocks of geometric length, anywhere in the series, round its end."""
    starts = generator.random((resamples, count)) < 1.0 / block
    starts[:, 0] = True
    first = generator.integers(count, size=(resamples, count))
    at = np.arange(count)
    began = np.maximum.accumulate(np.where(starts, at, 0), axis=1)
    rows: IntArray = (np.take_along_axis(first, began, axis=1) + at - began) % count
    return rows
