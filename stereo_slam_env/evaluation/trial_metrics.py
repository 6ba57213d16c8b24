"""The figures of one trial: one flat row of scalars, the row of the trial table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from filters.motion import POSITION, ROTATION
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.alarms import first_alarm
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.results import COUNTS, FilterRun
from stereo_slam_env.evaluation.trajectory_metrics import SegmentErrors

Kind = Literal["text", "integer", "real", "any"]


@dataclass(frozen=True)
class Column:
    """A column of the trial table.

    Attributes
    ----------
    unit : str
        "" where there is none.
    meaning : str
        What it is, and when it is null.
    kind : {"text", "integer", "real", "any"}
        Of its values.
    """

    unit: str
    meaning: str
    kind: Kind = "real"


COLUMNS: Mapping[str, Column] = {
    "filter": Column("", "label of the filter", "text"),
    "recording": Column("", "name of the recording", "text"),
    "seed": Column("", "seed of the recording; null for real data", "integer"),
    "frames": Column("", "scored frames: with truth, the first one left out", "integer"),
    "path_m": Column("m", "length of the true path over the scored frames"),
    "position_rmse_m": Column("m", "position error, not aligned; null with fewer than 3 scored frames"),
    "rotation_rmse_deg": Column("deg", "angle between estimated and true orientation"),
    "ate_rigid_m": Column("m", "absolute trajectory error after rigid alignment, without scale"),
    "end_error_m": Column("m", "position error in the last scored frame, not aligned"),
    "end_drift_percent": Column("%", "end_error_m over path_m; null where the vehicle stands still"),
    "final_position_sigma_m": Column("m", "claimed for end_error_m: root of the trace of the position's covariance"),
    "final_pose_logdet": Column("", "natural log of the determinant of that pose covariance, in m and rad"),
    "velocity_rmse_m_s": Column("m/s", "error of the linear velocity in W; null without true velocities"),
    "rpe_translation_percent": Column("%", "t_rel: relative translation error over all segments of all lengths"),
    "rpe_rotation_deg_per_100m": Column("deg/100 m", "r_rel: relative rotation error over the same segments"),
    "rpe_segments": Column("", "how many segments; 0 where the path is too short", "integer"),
    "landmark_rmse_m": Column("m", "median over frames of the error of landmarks within 40 m, relative to the camera"),
    "landmark_anees": Column("", "mean NEES of landmarks in (u, v, d); 3 is ideal, shown / 3"),
    "pose_anees": Column("", "mean NEES of the pose; 6 is ideal, shown / 6"),
    "position_anees": Column("", "mean NEES of the position; 3 is ideal, shown / 3"),
    "rotation_anees": Column("", "mean NEES of the rotation; 3 is ideal, shown / 3"),
    "nis": Column("", "normalised innovation squared per degree of freedom; 1 is ideal"),
    "nis_dof": Column("", "degrees of freedom of all innovations together", "integer"),
    "bound_position_m": Column("m", "Cramer-Rao bound of position_rmse_m; null where truth is not complete"),
    "bound_rotation_deg": Column("deg", "Cramer-Rao bound of rotation_rmse_deg"),
    "efficiency_percent": Column("%", "bound_position_m over position_rmse_m"),
    "ms_per_frame": Column("ms", "median over frames of predict + update, the first frame left out"),
    "ms_predict": Column("ms", "median of predict"),
    "ms_update": Column("ms", "median of update"),
    "memory_mb": Column("MB", "growth of the peak resident memory of the process; null where not known"),
    "state_size": Column("", "median dimension of the error state; null where the filter does not say"),
    "map_size": Column("", "median number of landmarks in the map"),
    "updated": Column("", "measurements that corrected the state", "integer"),
    "initialised": Column("", "landmarks that entered the map", "integer"),
    "dropped": Column("", "landmarks that left the map", "integer"),
    "gated": Column("", "measurements refused by the gate", "integer"),
    "rejected": Column("", "new landmarks refused", "integer"),
    "behind_camera": Column("", "measurements of landmarks predicted behind the camera, not used", "integer"),
    "failed_factorisations": Column("", "measurements whose S had no Cholesky factor, not used", "integer"),
    "negative_depth": Column("", "landmarks x frames seen and estimated at d <= 0", "integer"),
    "diverged": Column("", "1: failed, or ended farther off than the divergence limit", "integer"),
    "failure": Column("", "what the filter raised; null where it went through", "text"),
    "alarm_s": Column("s", "when the divergence monitor first raised an alarm, from the first frame on; null: never"),
    "alarm": Column("", "why, in one line", "text"),
}


EVENT_COLUMNS = tuple(name for name in COLUMNS if name in COUNTS and name != "map_size")
MEDIANS: Mapping[str, str] = {
    "landmark_rmse_m": "landmark_rmse",
    "ms_per_frame": "milliseconds",
    "ms_predict": "predict_milliseconds",
    "ms_update": "update_milliseconds",
    "state_size": "state_size",
}
"""Columns that are the median over frames of a series of `FilterRun`."""

FEWEST_FRAMES = 3  # an alignment needs so many


def trial_figures(
    run: FilterRun, *, divergence_percent: float, bound: Bound | None = None
) -> dict[str, float | int | str | None]:
    """The figures of one run: the columns of `COLUMNS`, in that order.

    The first frame only initialises and is not scored, nor are frames without truth. What does not apply is None;
    of a run that failed, that is all but its events and alarms.

    Parameters
    ----------
    run : FilterRun
        One trial.
    divergence_percent : float
        The run diverged if it ends farther from the truth than this share of the distance travelled.
    bound : Bound, optional
        Theoretical limit on its recording.

    Raises
    ------
    ValueError
        The bound is of another number of frames.
    """
    if bound is not None and len(bound.pose) != len(run):
        raise ValueError(f"bound must have one entry a frame: {len(bound.pose)} entries, {len(run)} frames")
    figures: dict[str, float | int | str | None] = dict.fromkeys(COLUMNS)
    figures |= {"filter": run.filter_name, "recording": run.recording_name, "seed": run.seed, "failure": run.failure}
    figures |= {event: int(run.counts[event].sum()) for event in EVENT_COLUMNS if event in run.counts}
    figures |= {"frames": 0, "rpe_segments": 0, "nis_dof": 0, "diverged": 1}
    alarm = first_alarm(run)
    if alarm is not None:
        figures |= {"alarm_s": alarm.time, "alarm": alarm.words}
    if run.failure is not None:
        return figures
    at, relative = scored_frames(run), segments(run)
    figures |= {"frames": int(at.sum()), "rpe_segments": len(relative), "nis_dof": int(run.nis_dof.sum())}
    errors = _errors(run, at)
    measured = {**errors, **_claims(run, at), **_limits(bound, at, errors), **_consistency(run), **_costs(run)}
    measured["rpe_translation_percent"] = mean(relative.translation_percent)
    measured["rpe_rotation_deg_per_100m"] = mean(relative.rotation_deg_per_100m)
    figures |= {name: number(value) for name, value in measured.items()}
    figures["diverged"] = int(errors.get("end_drift_percent", 0.0) > divergence_percent)
    return figures


def scored_frames(run: FilterRun) -> BoolArray:
    """Frames with a finite position and truth, but for the first; (K,)."""
    known = np.array(np.isfinite(run.positions).all(axis=1) & np.isfinite(run.true_positions).all(axis=1))
    known[:1] = False
    return known


def position_rmse(run: FilterRun) -> float:
    """Position error of a run, m; NaN if it failed or has fewer than `FEWEST_FRAMES` scored frames."""
    at = scored_frames(run)
    if run.failure is not None or at.sum() < FEWEST_FRAMES:
        return float("nan")
    return metrics.ate_unaligned(run.positions[at], run.true_positions[at])


def segments(run: FilterRun) -> SegmentErrors:
    """Relative errors of a run over its scored frames."""
    at = scored_frames(run)
    return metrics.segment_errors(
        run.positions[at], run.orientations[at], run.true_positions[at], run.true_orientations[at]
    )


def pooled(runs: Sequence[FilterRun], name: str) -> FloatArray:
    """The finite values of a series of all runs, without their first frames."""
    return finite(np.concatenate([np.zeros(0), *(getattr(run, name)[1:] for run in runs)]))


def nis_per_dof(runs: Sequence[FilterRun]) -> float:
    """NIS per degree of freedom over all innovations of all runs; NaN where there are none."""
    dof = sum(int(run.nis_dof.sum()) for run in runs)
    return sum(float(np.nansum(run.nis)) for run in runs) / dof if dof else float("nan")


def landmark_anees(runs: Sequence[FilterRun]) -> float:
    """Mean NEES over all landmarks, frames and runs; NaN without truth."""
    total = LandmarkStatistics.total(run.landmark_statistics for run in runs)
    count = total.nees_count.sum()
    return float(total.nees.sum() / count) if count else float("nan")


def finite(values: Iterable[float | None] | FloatArray) -> FloatArray:
    """The values that are known and finite."""
    array = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    return array[np.isfinite(array)]


def mean(values: FloatArray) -> float:
    """Of finite values; NaN where there are none."""
    return float(values.mean()) if len(values) else float("nan")


def median(values: FloatArray | IntArray) -> float:
    """Of finite values; NaN where there are none."""
    return float(np.median(values)) if len(values) else float("nan")


def number(value: float | None) -> float | None:
    """The value, or None where it is not finite."""
    return None if value is None or not np.isfinite(value) else float(value)


def _errors(run: FilterRun, at: BoolArray) -> dict[str, float]:
    velocity = run.linear_velocities[1:] - run.true_linear_velocities[1:]
    velocity = velocity[np.isfinite(velocity).all(axis=1)]
    figures = {"velocity_rmse_m_s": metrics.root_mean_square(velocity) if len(velocity) else float("nan")}
    if at.sum() < FEWEST_FRAMES:
        return figures
    estimate, truth = run.positions[at], run.true_positions[at]
    path, end = metrics.path_length(truth), float(np.linalg.norm(estimate[-1] - truth[-1]))
    angles = metrics.rotation_errors(run.orientations[at], run.true_orientations[at])
    return figures | {
        "path_m": path,
        "position_rmse_m": position_rmse(run),
        "rotation_rmse_deg": float(np.rad2deg(metrics.root_mean_square(angles))),
        "ate_rigid_m": metrics.ate_rigid(estimate, truth),
        "end_error_m": end,
        "end_drift_percent": metrics.end_drift_percent(estimate, truth) if path > 0 else float("nan"),
    }


def _claims(run: FilterRun, at: BoolArray) -> dict[str, float]:
    """What the filter says of its pose in the last scored frame; without truth, in the last one."""
    last = np.flatnonzero(at if at.any() else np.isfinite(run.pose_covariances).all(axis=(1, 2)))[-1:]
    if len(last) == 0:
        return {}
    covariance = run.pose_covariances[last[0]]
    sign, log_determinant = np.linalg.slogdet(covariance)
    return {
        "final_position_sigma_m": float(np.sqrt(np.trace(covariance[POSITION, POSITION]))),
        "final_pose_logdet": float(log_determinant) if sign > 0 else float("nan"),
    }


def _limits(bound: Bound | None, at: BoolArray, errors: Mapping[str, float]) -> dict[str, float]:
    if bound is None or not at.any():
        return {}
    position, rotation = (
        float(np.sqrt(np.mean(np.trace(bound.pose[at, part, part], axis1=1, axis2=2)))) for part in (POSITION, ROTATION)
    )
    error = errors.get("position_rmse_m", 0.0)
    return {
        "bound_position_m": position,
        "bound_rotation_deg": float(np.rad2deg(rotation)),
        "efficiency_percent": 100.0 * position / error if error > 0 else float("nan"),
    }


def _consistency(run: FilterRun) -> dict[str, float]:
    anees = {f"{what}_anees": mean(pooled([run], f"{what}_nees")) for what in ("pose", "position", "rotation")}
    return {**anees, "landmark_anees": landmark_anees([run]), "nis": nis_per_dof([run])}


def _costs(run: FilterRun) -> dict[str, float]:
    medians = {column: median(pooled([run], series)) for column, series in MEDIANS.items()}
    return {**medians, "map_size": median(run.counts["map_size"][1:]), "memory_mb": run.memory_mb}
