"""The figures of one trial: one flat row of scalars, the row of the trial table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from stereo_slam_env.benchmark.limits import Bound
from stereo_slam_env.benchmark.results import FilterRun

Kind = Literal["text", "integer", "real"]


@dataclass(frozen=True)
class Column:
    """A column of the trial table.

    Attributes
    ----------
    unit : str
        "" where there is none.
    meaning : str
        What it is, and when it is null.
    kind : {"text", "integer", "real"}
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
    "velocity_rmse_m_s": Column("m/s", "error of the linear velocity in W; null without true velocities"),
    "rpe_translation_percent": Column("%", "t_rel: relative translation error over all segments of all lengths"),
    "rpe_rotation_deg_per_100m": Column("deg/100 m", "r_rel: relative rotation error over the same segments"),
    "rpe_segments": Column("", "how many segments; 0 where the path is too short", "integer"),
    "landmark_rmse_m": Column("m", "median over frames of the error of landmarks within 40 m, relative to the camera"),
    "landmark_anees": Column("", "mean NEES of landmarks in (u, v, d); 3 is ideal"),
    "pose_anees": Column("", "mean NEES of the pose; 6 is ideal"),
    "position_anees": Column("", "mean NEES of the position; 3 is ideal"),
    "rotation_anees": Column("", "mean NEES of the rotation; 3 is ideal"),
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
}


def trial_figures(
    run: FilterRun, *, bound: Bound | None = None, divergence_percent: float = 10.0
) -> dict[str, float | int | str | None]:
    """The figures of one run: the columns of `COLUMNS`, in that order; what does not apply is None."""
    raise NotImplementedError
