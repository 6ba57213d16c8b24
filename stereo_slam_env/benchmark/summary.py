"""From the runs of a filter to its row in the result table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from filters.validation import BoolArray, FloatArray
from stereo_slam_env.benchmark import trajectory_metrics as metrics
from stereo_slam_env.benchmark.consistency import mean_band, share_inside
from stereo_slam_env.benchmark.limits import Bound
from stereo_slam_env.benchmark.results import FilterRun, FilterSummary

POSE_DOF = 6


Bounds = Mapping[tuple[str, int | None], Bound]
"""Theoretical limits by (recording_name, seed)."""


def summarise(
    runs: Sequence[FilterRun], *, divergence_percent: float = 10.0, bounds: Bounds | None = None
) -> FilterSummary:
    """Figures of one filter over its runs.

    The first frame only initialises and is not scored, nor are frames without truth. A run that failed counts as
    diverged and has no part in the other figures; one that diverged with finite numbers has.

    Parameters
    ----------
    runs : sequence of FilterRun
        Of one filter, one a seed.
    divergence_percent : float
        A run diverged if it ends farther from the truth than this share of the distance travelled.

    Raises
    ------
    ValueError
        No runs, or runs of different filters.
    """
    if not runs:
        raise ValueError("runs must hold at least one run")
    names = sorted({run.filter_name for run in runs})
    if len(names) > 1:
        raise ValueError(f"runs must be of one filter, got {', '.join(names)}")
    complete = [run for run in runs if run.failure is None]
    scored = [_scored(run) for run in complete]
    with_truth = [(run, at) for run, at in zip(complete, scored, strict=True) if at.sum() >= 3]
    drifts = [_end_drift(run, at) for run, at in with_truth]
    rmse_by_run = [
        metrics.ate_unaligned(run.positions[at], run.true_positions[at]) if enough else float("nan")
        for run, at, enough in ((run, _scored(run), _scored(run).sum() >= 3 and run.failure is None) for run in runs)
    ]
    nees_by_frame = _mean_over_runs([run.pose_nees for run in complete])
    band = mean_band(POSE_DOF, len(complete)) if complete else None
    return FilterSummary(
        filter_name=names[0],
        options=runs[0].options,
        runs=len(runs),
        frames=int(sum(at.sum() for at in scored)),
        position_rmse_m=_root_mean_square(rmse_by_run),
        position_rmse_by_run=tuple(rmse_by_run),
        rotation_rmse_deg=_root_mean_square([_rotation_rmse(run, at) for run, at in with_truth]),
        ate_rigid_m=_median([metrics.ate_rigid(run.positions[at], run.true_positions[at]) for run, at in with_truth]),
        end_drift_percent=_mean(drifts),
        velocity_rmse_m_s=_root_mean_square([_velocity_rmse(run) for run in complete]),
        pose_anees=_mean(nees_by_frame),
        pose_anees_band=band if np.isfinite(nees_by_frame).any() else None,
        frames_in_band_percent=_number(100.0 * share_inside(nees_by_frame, band)) if band else None,
        nis=_nis(complete),
        landmark_anees=_mean(_after_first(complete, "landmark_nees")),
        landmark_rmse_m=_median(_after_first(complete, "landmark_rmse")),
        ms_per_frame=_median(_after_first(complete, "milliseconds")),
        gated_percent=_gated_percent(complete),
        rejected=_total(runs, "rejected"),
        behind_camera=_total(runs, "behind_camera"),
        failed_factorisations=_total(runs, "failed_factorisations"),
        diverged=len(runs) - len(complete) + sum(drift > divergence_percent for drift in drifts),
        failures=tuple(
            run.failure if run.seed is None else f"seed {run.seed}, {run.failure}"
            for run in runs
            if run.failure is not None
        ),
    )


def summarise_all(
    runs: Sequence[FilterRun], *, divergence_percent: float = 10.0, bounds: Bounds | None = None
) -> tuple[FilterSummary, ...]:
    """One summary a filter, in order of first appearance."""
    by_filter: dict[str, list[FilterRun]] = {}
    for run in runs:
        by_filter.setdefault(run.filter_name, []).append(run)
    return tuple(summarise(group, divergence_percent=divergence_percent, bounds=bounds) for group in by_filter.values())


def _scored(run: FilterRun) -> BoolArray:
    known = np.array(np.isfinite(run.positions).all(axis=1) & np.isfinite(run.true_positions).all(axis=1))
    known[:1] = False
    return known


def _end_drift(run: FilterRun, at: BoolArray) -> float:
    try:
        return metrics.end_drift_percent(run.positions[at], run.true_positions[at])
    except ValueError:  # a vehicle that stands still has no drift in percent
        return float("nan")


def _rotation_rmse(run: FilterRun, at: BoolArray) -> float:
    angles = metrics.rotation_errors(run.orientations[at], run.true_orientations[at])
    return float(np.rad2deg(metrics.root_mean_square(angles)))


def _velocity_rmse(run: FilterRun) -> float:
    errors = (run.linear_velocities - run.true_linear_velocities)[1:]
    finite = errors[np.isfinite(errors).all(axis=1)]
    return metrics.root_mean_square(finite) if len(finite) else float("nan")


def _mean_over_runs(series: Sequence[FloatArray]) -> FloatArray:
    """Mean over runs frame by frame; a frame counts only where every run has a value."""
    if not series:
        return np.full(0, np.nan)
    length = min(len(values) for values in series)
    return np.asarray(np.mean([values[1:length] for values in series], axis=0))


def _after_first(runs: Sequence[FilterRun], name: str) -> FloatArray:
    return np.concatenate([np.zeros(0), *(getattr(run, name)[1:] for run in runs)])


def _nis(runs: Sequence[FilterRun]) -> float | None:
    dof = sum(int(run.nis_dof.sum()) for run in runs)
    return _number(sum(float(np.nansum(run.nis)) for run in runs) / dof) if dof else None


def _gated_percent(runs: Sequence[FilterRun]) -> float | None:
    gated, updated = _total(runs, "gated"), _total(runs, "updated")
    return 100.0 * gated / (gated + updated) if gated + updated else None


def _total(runs: Sequence[FilterRun], event: str) -> int:
    return int(sum(run.counts[event].sum() for run in runs))


def _finite(values: Sequence[float] | FloatArray) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def _mean(values: Sequence[float] | FloatArray) -> float | None:
    finite = _finite(values)
    return float(finite.mean()) if finite.size else None


def _median(values: Sequence[float] | FloatArray) -> float | None:
    finite = _finite(values)
    return float(np.median(finite)) if finite.size else None


def _root_mean_square(values: Sequence[float] | FloatArray) -> float | None:
    finite = _finite(values)
    return metrics.root_mean_square(finite) if finite.size else None


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
