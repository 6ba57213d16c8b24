"""From the runs of a filter to its row in the result table: what `trial_metrics` says of each, put together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency_figures import consistency_figures
from stereo_slam_env.evaluation.map_figures import depth_convergence, range_errors
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary, SegmentError
from stereo_slam_env.evaluation.run_figures import Figures, RunFigures
from stereo_slam_env.evaluation.trajectory_metrics import SegmentErrors, root_mean_square
from stereo_slam_env.evaluation.trial_metrics import (
    MEDIANS,
    finite,
    mean,
    median,
    number,
    pooled,
    segments,
)


def summarise(runs: Sequence[FilterRun], figures: RunFigures) -> FilterSummary:
    """Figures of one filter over its runs.

    The first frame only initialises and is not scored, nor are frames without truth. A run that failed counts as
    diverged and has no part in the other figures but the event counts; one that diverged with finite numbers has.

    Parameters
    ----------
    runs : sequence of FilterRun
        Of one filter, one a seed.
    figures : RunFigures
        Of the same runs, see `figures_of`.

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
    trials = figures.of(runs)

    def column(name: str) -> FloatArray:
        return np.array([np.nan if trial[name] is None else trial[name] for trial in trials], dtype=np.float64)

    def root_mean_square_of(name: str) -> float | None:
        known = finite(column(name))
        return root_mean_square(known) if len(known) else None

    def total(name: str) -> int:
        return int(np.nansum(column(name)))

    complete = [run for run in runs if run.failure is None]
    medians = {name: number(median(pooled(complete, series))) for name, series in MEDIANS.items()}
    consistency = consistency_figures(complete)
    efficiencies = column("efficiency_percent")
    pose, nis, landmark = (consistency.get(what) for what in ("pose", "nis", "landmark"))
    relative = _together([segments(run) for run in complete])
    statistics = [run.landmark_statistics for run in complete]
    known, gated = total("updated") + total("gated"), total("gated")
    return FilterSummary(
        filter_name=names[0],
        options=runs[0].options,
        not_given=next((run.not_given for run in runs if run.not_given), {}),
        runs=len(runs),
        frames=total("frames"),
        position_rmse_m=root_mean_square_of("position_rmse_m"),
        position_rmse_by_run=tuple(column("position_rmse_m").tolist()),
        rotation_rmse_deg=root_mean_square_of("rotation_rmse_deg"),
        ate_rigid_m=number(median(finite(column("ate_rigid_m")))),
        end_drift_percent=number(mean(finite(column("end_drift_percent")))),
        velocity_rmse_m_s=root_mean_square_of("velocity_rmse_m_s"),
        pose_anees=None if pose is None else pose.mean,
        pose_anees_band=None if pose is None else pose.band,
        frames_in_band_percent=None if pose is None else pose.inside_percent,
        nis=None if nis is None else nis.mean,
        landmark_anees=None if landmark is None else landmark.mean,
        gated_percent=100.0 * gated / known if known else None,
        rejected=total("rejected"),
        behind_camera=total("behind_camera"),
        failed_factorisations=total("failed_factorisations"),
        diverged=total("diverged"),
        alarmed=int(np.isfinite(column("alarm_s")).sum()),
        failures=tuple(
            run.failure if run.seed is None else f"seed {run.seed}, {run.failure}"
            for run in runs
            if run.failure is not None
        ),
        bound_position_m=root_mean_square_of("bound_position_m"),
        bound_rotation_deg=root_mean_square_of("bound_rotation_deg"),
        efficiency_percent=_efficiency(column("bound_position_m"), column("position_rmse_m")),
        efficiency_by_run=tuple(efficiencies.tolist()) if np.isfinite(efficiencies).any() else (),
        consistency=consistency,
        rpe=_by_length(relative),
        rpe_translation_percent=number(mean(relative.translation_percent)),
        rpe_rotation_deg_per_100m=number(mean(relative.rotation_deg_per_100m)),
        landmark_by_range=range_errors(statistics),
        depth_convergence=depth_convergence(statistics),
        negative_depth=total("negative_depth"),
        end_error_m=root_mean_square_of("end_error_m"),
        final_position_sigma_m=root_mean_square_of("final_position_sigma_m"),
        final_pose_logdet=number(mean(finite(column("final_pose_logdet")))),
        memory_mb=number(max(finite(column("memory_mb")), default=None)),
        **medians,
    )


def summarise_all(runs: Sequence[FilterRun], figures: Figures) -> tuple[FilterSummary, ...]:
    """One summary a filter, in order of first appearance; `figures` are those of the same runs."""
    by_filter: dict[str, list[FilterRun]] = {}
    for run in runs:
        by_filter.setdefault(run.filter_name, []).append(run)
    return tuple(summarise(group, figures[name]) for name, group in by_filter.items())


def _efficiency(bounds: FloatArray, errors: FloatArray) -> float | None:
    """Root mean square bound over root mean square error, in percent, over the runs that have both."""
    both = np.isfinite(bounds) & np.isfinite(errors)
    squared = np.sum(np.square(errors[both]))
    return float(100.0 * np.sqrt(np.sum(np.square(bounds[both])) / squared)) if squared > 0 else None


def _together(parts: Sequence[SegmentErrors]) -> SegmentErrors:
    """The segments of all runs."""
    nothing = np.zeros(0)
    return SegmentErrors(
        *(
            np.concatenate([nothing, *(getattr(part, name) for part in parts)])
            for name in ("lengths", "translation_percent", "rotation_deg_per_100m")
        )
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
