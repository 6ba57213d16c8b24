"""NEES and NIS of many runs and their bands (Bar-Shalom, Li and Kirubarajan, 2001, section 5.4).

Runs are independent, so the mean of a NEES over N of them is chi-square with N times its degrees of freedom, over N,
frame by frame. The frames of one run are not: the mean over frames is hardly surer than that of one frame, and has the
same band. Innovations of a consistent filter are white, so those of all frames count.

The landmarks of one frame share the pose they are seen from and its past; on the reference drive the mean over 77 of
them scatters like that over 14 independent ones, elsewhere like another number. So their band is what the scatter
between the runs says (Student's t), but never wider than if each frame had one landmark only: a filter that goes
astray in one run of many must not excuse itself by its scatter. A single run has the latter band.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import gammaincinv, stdtrit

from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.results import ConsistencyFigure, FilterRun
from stereo_slam_env.evaluation.trajectory_metrics import mean

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
    found = {what: _nees_figure(runs, what) for what in ("pose", "position", "rotation")}
    found |= {"landmark": _landmark_figure(runs), "nis": _nis_figure(runs)}
    return {what: figure for what, figure in found.items() if figure is not None}


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
    known = sum(int(run.nis_dof.sum()) > 0 for run in runs)
    return ConsistencyFigure(nis_per_dof(runs), 1, mean_band(1, total), inside, known)


def _figure(values: FloatArray, average: float, dof: int, band: Band) -> ConsistencyFigure | None:
    """The average with the band of the means (N,) of the runs, and the share of frames inside theirs."""
    known = np.isfinite(values)
    runs, frames = known.any(axis=1), known.any(axis=0)
    if not np.isfinite(average) or not runs.any():
        return None
    by_run = np.nanmean(values[runs], axis=1)[:, None]
    low, high = band(by_run, np.array([len(by_run)]))
    some = values[:, frames]
    inside = _percent_inside(np.nanmean(some, axis=0), band(some, known[:, frames].sum(axis=0)))
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
