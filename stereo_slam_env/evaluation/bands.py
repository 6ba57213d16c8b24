"""Bands of NEES and NIS of a consistent filter, and intervals by the bootstrap.

Bar-Shalom, Li and Kirubarajan (2001), section 5.4.

Runs are independent, so the mean of a NEES over N of them is chi-square with N times its degrees of freedom, over N,
frame by frame. The frames of one run are not: the mean over frames is hardly surer than that of one frame, and has the
same band. Innovations of a consistent filter are white, so those of all frames count.

The landmarks of one frame share the pose they are seen from and its past; on the reference drive the mean over 77 of
them scatters like that over 14 independent ones, elsewhere like another number. So their band is what the scatter
between the runs says (Student's t), but never wider than if each frame had one landmark only: a filter that goes
astray in one run of many must not excuse itself by its scatter. A single run has the latter band.

References
----------
Hall, *The Bootstrap and Edgeworth Expansion*, 1992, section 3.5 (symmetric studentised). Politis and Romano, "The
stationary bootstrap", JASA 89(428), 1994. Politis and White, "Automatic block-length selection for the dependent
bootstrap", Econometric Reviews 23(1), 2004.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, stdtrit

from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.results import ConsistencyFigure, FilterRun
from stereo_slam_env.evaluation.trajectory_metrics import mean

RESAMPLES = 2000  # of the frames of a run
RESAMPLES_OF_RUNS = 4999
RESAMPLES_OF_RATIOS = 10_000
FEWEST = 8  # values below which the length of a block is not estimated
_CALM = 5  # lags in a row without correlation that end the search for it
_MOST_AT_ONCE, _MOST_DRAWN = 5_000_000, 2_000_000


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


def studentised_interval(values: FloatArray, confidence: float, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Interval of the mean of each column of (n, m) values: the symmetric studentised bootstrap; low and high (m,).

    Rows are resampled, the same for all columns; half the width is the standard error times the `confidence` quantile
    of |mean* - mean| / error*. n >= 2.
    """
    values = np.asarray(values, dtype=np.float64)
    shift, spread = _resampled(values, seed)
    quantile = np.quantile(_ratio(np.abs(shift), np.sqrt(spread)), confidence, axis=0)
    mean = values.mean(axis=0)
    half = quantile * values.std(axis=0, ddof=1) / math.sqrt(len(values))
    return mean - half, mean + half


def welch_interval(first: FloatArray, second: FloatArray, confidence: float) -> tuple[float, float]:
    """Interval of the difference of the means of two independent samples (n,), (m,): Welch's t, its law resampled."""
    (shift_a, spread_a), (shift_b, spread_b) = _resampled(first[:, None], 0), _resampled(second[:, None], 1)
    studentised = _ratio(np.abs(shift_a - shift_b), np.sqrt(spread_a + spread_b))
    error = math.sqrt(first.var(ddof=1) / len(first) + second.var(ddof=1) / len(second))
    estimate, half = float(first.mean() - second.mean()), error * float(np.quantile(studentised, confidence))
    return estimate - half, estimate + half


def rms_ratio_interval(first: FloatArray, second: FloatArray, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of the ratio of the root mean squares of two paired samples (N,), in one unit; pairs are drawn together.

    By percentiles, seeded: a ratio of means of squares, which are far from Gaussian, has no useful standard error. With
    ten runs it is a rough one.
    """
    generator, count = np.random.default_rng(0), len(first)
    ratios = []
    parts = np.array_split(np.arange(RESAMPLES_OF_RATIOS), -(-RESAMPLES_OF_RATIOS * count // _MOST_DRAWN))
    for part in parts:  # for little memory
        drawn = generator.integers(count, size=(len(part), count))
        ratios.append(np.sqrt(np.square(first)[drawn].sum(axis=1) / np.square(second)[drawn].sum(axis=1)))
    low, high = np.quantile(np.concatenate(ratios), [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    return float(low), float(high)


@lru_cache(maxsize=4)
def _resamples(count: int, seed: int) -> tuple[NDArray[np.uint16], ...]:
    """Number of draws of each of `count` rows, (RESAMPLES_OF_RUNS, count), in parts, for little memory."""
    generator, shares = np.random.default_rng([seed, count]), np.full(count, 1.0 / count)
    parts = np.array_split(np.arange(RESAMPLES_OF_RUNS), -(-RESAMPLES_OF_RUNS * count // _MOST_AT_ONCE))
    return tuple(generator.multinomial(count, shares, len(part)).astype(np.uint16) for part in parts)


def _resampled(values: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Shift of the mean and squared standard error of each resample, (RESAMPLES_OF_RUNS, m)."""
    count = len(values)
    centred = values - values.mean(axis=0)
    parts = (part.astype(np.float64) for part in _resamples(count, seed))
    means = [(part @ centred / count, part @ centred**2 / count) for part in parts]
    shift, squares = (np.concatenate(column) for column in zip(*means, strict=True))
    return shift, np.maximum(squares - shift**2, 0.0) / (count - 1)


def _ratio(shift: FloatArray, error: FloatArray) -> FloatArray:
    """|t| of each resample; 0 for one that drew a single row and has no spread."""
    tiny = 1e-9 * error.max(axis=0, initial=0.0)
    return np.divide(shift, error, out=np.zeros_like(shift), where=error > tiny)


PROBABILITY = 0.95
DOF = {"pose": 6, "position": 3, "rotation": 3, "landmark": 3}
"""Degrees of freedom of a NEES."""

Bands = tuple[FloatArray, FloatArray]
Band = Callable[[FloatArray, IntArray], Bands]
"""(values (N, K) with NaN where there is none, how many there are in each column (K,)) -> low, high (K,)."""


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
    return 2.0 * gammaincinv(runs * dof / 2, tail) / runs, 2.0 * gammaincinv(runs * dof / 2, 1.0 - tail) / runs


def share_inside(values: FloatArray, band: tuple[float, float]) -> float:
    """Share of the finite `values` inside `band`, 0 to 1; NaN where none is finite."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return float("nan")
    return float(np.mean((finite >= band[0]) & (finite <= band[1])))


def consistency_figures(runs: Sequence[FilterRun]) -> dict[str, ConsistencyFigure]:
    """NEES and NIS of runs that went through, against their bands, by quantity; what is not known is left out."""
    figures = {what: _nees_figure(runs, what) for what in ("pose", "position", "rotation")}
    figures |= {"landmark": _landmark_figure(runs), "nis": _nis_figure(runs)}
    return {what: figure for what, figure in figures.items() if figure is not None}


def pooled(runs: Sequence[FilterRun], name: str) -> FloatArray:
    """Finite values of a series of all runs, without their first frames."""
    values: FloatArray = np.concatenate([np.zeros(0), *(getattr(run, name)[1:] for run in runs)])
    return values[np.isfinite(values)]


def nis_per_dof(runs: Sequence[FilterRun]) -> float:
    """NIS per degree of freedom over all innovations of all runs; NaN where there are none."""
    dof = sum(int(run.nis_dof.sum()) for run in runs)
    return sum(float(np.nansum(run.nis)) for run in runs) / dof if dof else float("nan")


def landmark_anees(runs: Sequence[FilterRun]) -> float:
    """Mean NEES over all landmarks, frames and runs; NaN without truth."""
    total = LandmarkStatistics.total(run.landmark_statistics for run in runs)
    count = total.nees_count.sum()
    return float(total.nees.sum() / count) if count else float("nan")


def _nees_figure(runs: Sequence[FilterRun], what: str) -> ConsistencyFigure | None:
    series, dof = f"{what}_nees", DOF[what]
    return _figure(_by_run(runs, series), mean(pooled(runs, series)), dof, lambda _, count: mean_bands(dof, count))


def _landmark_figure(runs: Sequence[FilterRun]) -> ConsistencyFigure | None:
    return _figure(_by_run(runs, "landmark_nees"), landmark_anees(runs), DOF["landmark"], _bands_by_scatter)


def _nis_figure(runs: Sequence[FilterRun]) -> ConsistencyFigure | None:
    total = sum(int(run.nis_dof.sum()) for run in runs)
    if not total:
        return None
    nis, dof = _by_run(runs, "nis"), _by_run(runs, "nis_dof")
    dof_by_frame = np.nansum(dof, axis=0)
    some = dof_by_frame > 0
    by_frame = np.nansum(nis, axis=0)[some] / dof_by_frame[some]
    inside = _percent_inside(by_frame, mean_bands(1, dof_by_frame[some]))
    known_runs = sum(int(run.nis_dof.sum()) > 0 for run in runs)
    return ConsistencyFigure(nis_per_dof(runs), 1, mean_band(1, total), inside, known_runs)


def _figure(values: FloatArray, average: float, dof: int, band: Band) -> ConsistencyFigure | None:
    """The average with the band of the means (N,) of the runs, and the share of frames inside theirs."""
    finite = np.isfinite(values)
    runs, frames = finite.any(axis=1), finite.any(axis=0)
    if not np.isfinite(average) or not runs.any():
        return None
    by_run = np.nanmean(values[runs], axis=1)[:, None]
    low, high = band(by_run, np.array([len(by_run)]))
    some = values[:, frames]
    inside = _percent_inside(np.nanmean(some, axis=0), band(some, finite[:, frames].sum(axis=0)))
    return ConsistencyFigure(average, dof, (float(low[0]), float(high[0])), inside, len(by_run))


def _bands_by_scatter(values: FloatArray, count: IntArray) -> Bands:
    """Band of the means of the columns of landmark NEES whose expectation is that of a consistent filter."""
    dof = DOF["landmark"]
    low, high = mean_bands(dof, count)
    several = count > 1
    scatter = np.nanstd(values[:, several], axis=0, ddof=1) / np.sqrt(count[several])
    reach = stdtrit(count[several] - 1, 0.5 + 0.5 * PROBABILITY) * scatter
    low[several] = np.maximum(low[several], dof - reach)
    high[several] = np.minimum(high[several], dof + reach)
    return low, high


def _percent_inside(values: FloatArray, bands: Bands) -> float:
    return float(100.0 * np.mean((values >= bands[0]) & (values <= bands[1])))


def _by_run(runs: Sequence[FilterRun], name: str) -> FloatArray:
    """A series without the first frame, one row a run; NaN behind the end of shorter ones."""
    rows = [np.asarray(getattr(run, name)[1:], dtype=np.float64) for run in runs]
    table = np.full((len(rows), max((len(row) for row in rows), default=0)), np.nan)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    return table
