"""What a filter did on a recording: the time series that metrics, store, plots and report share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from filters.validation import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class LandmarkTrace:
    """Depth of one landmark as a filter saw it, frame by frame (the paper's section 4.3).

    Attributes
    ----------
    landmark_id : int
        Identity.
    label : str
        "near" or "far".
    frames : (L,) int64
        Indices of the frames in which the landmark was in the map.
    depth, sigma : (L,)
        Estimated depth z in the current camera and its standard deviation, m.
    true_depth : (L,)
        m; NaN where unknown.
    measured_depth : (L,)
        From the frame's own disparity alone, m; NaN where not seen or d <= 0.
    """

    landmark_id: int
    label: str
    frames: IntArray
    depth: FloatArray
    sigma: FloatArray
    true_depth: FloatArray
    measured_depth: FloatArray


@dataclass(frozen=True, eq=False)
class FilterRun:
    """One filter on one recording. K frames; per-frame arrays hold NaN where a quantity is unknown.

    Attributes
    ----------
    filter_name, recording_name : str
        What ran on what.
    options : mapping
        Options the filter was made with (JSON-able).
    seed : int, optional
        Seed of the recording; None for real data.
    timestamps : (K,)
        s.
    positions, orientations : (K, 3), (K, 4)
        Estimated r^WC, m, and q^WC, xyzw.
    pose_covariances : (K, 6, 6)
        Of the `PoseBelief`.
    linear_velocities, angular_velocities : (K, 3)
        Estimated; m/s in W, rad/s in the camera frame.
    velocity_covariances : (K, 6, 6)
        Of the `VelocityBelief`.
    true_positions, true_orientations : (K, 3), (K, 4)
        NaN where there is no truth.
    true_linear_velocities, true_angular_velocities : (K, 3)
        NaN where there is no truth.
    pose_errors : (K, 6)
        The filter's own `pose_error`.
    pose_nees : (K,)
        e^T P^-1 e of that error (6 degrees of freedom).
    landmark_nees : (K,)
        Mean over the landmarks of the frame, in (u, v, d) space (3 degrees of freedom).
    landmark_rmse : (K,)
        Root mean square position error of the landmarks of the frame relative to the camera, m.
    nis : (K,)
        Normalised innovation squared.
    nis_dof : (K,) int64
        Its degrees of freedom.
    milliseconds : (K,)
        Predict + update.
    counts : mapping of str to (K,) int64
        "updated", "initialised", "dropped", "gated", "rejected", "behind_camera", "failed_factorisations",
        "map_size".
    traces : tuple of LandmarkTrace
        Depth histories of a near and a far landmark, the same ids for every filter of a recording.
    failure : str, optional
        One line when the filter raised or returned nonsense; arrays are NaN from there on.
    """

    filter_name: str
    recording_name: str
    options: Mapping[str, Any]
    seed: int | None
    timestamps: FloatArray
    positions: FloatArray
    orientations: FloatArray
    pose_covariances: FloatArray
    linear_velocities: FloatArray
    angular_velocities: FloatArray
    velocity_covariances: FloatArray
    true_positions: FloatArray
    true_orientations: FloatArray
    true_linear_velocities: FloatArray
    true_angular_velocities: FloatArray
    pose_errors: FloatArray
    pose_nees: FloatArray
    landmark_nees: FloatArray
    landmark_rmse: FloatArray
    nis: FloatArray
    nis_dof: IntArray
    milliseconds: FloatArray
    counts: Mapping[str, IntArray]
    traces: tuple[LandmarkTrace, ...] = ()
    failure: str | None = None

    def __len__(self) -> int:
        return len(self.timestamps)


@dataclass(frozen=True)
class FilterSummary:
    """The figures of one filter over all its runs: one row of the result table, one entry of `summary.json`.

    A value is None (JSON null) where it does not apply (no truth, one run, ...).

    Attributes
    ----------
    runs, frames : int
        Number of recordings, and of scored frames over all of them.
    position_rmse_m, position_rmse_by_run : float, tuple of float
        Without alignment, over scored frames; the first is the root mean square over runs.
    rotation_rmse_deg : float
        Root mean square rotation error.
    ate_rigid_m : float
        Absolute trajectory error after rigid alignment (no scale), median over runs.
    end_drift_percent : float
        Final position error / distance travelled, mean over runs.
    velocity_rmse_m_s : float
        Linear velocity error.
    pose_anees, pose_anees_band : float, pair of float
        Mean over frames and runs of the pose NEES (6 degrees of freedom, so 6 is ideal), and the two-sided
        95 % chi-square band of the mean over this number of runs.
    frames_in_band_percent : float
        Share of the frames whose NEES, averaged over runs, lies inside the band.
    nis : float
        NIS per degree of freedom (1 is ideal).
    landmark_anees : float
        Landmark NEES in (u, v, d) space (3 is ideal).
    landmark_rmse_m : float
        Landmark error relative to the camera.
    ms_per_frame : float
        Median over frames of predict + update.
    gated_percent : float
        Share of known measurements gated.
    rejected, behind_camera, failed_factorisations : int
        Event counts over all runs.
    diverged : int
        Runs that failed, returned non-finite numbers, or ended farther from the truth than the divergence limit.
    failures : tuple of str
        One line for each run that raised.
    """

    filter_name: str
    options: Mapping[str, Any]
    runs: int
    frames: int
    position_rmse_m: float | None
    position_rmse_by_run: tuple[float, ...]
    rotation_rmse_deg: float | None
    ate_rigid_m: float | None
    end_drift_percent: float | None
    velocity_rmse_m_s: float | None
    pose_anees: float | None
    pose_anees_band: tuple[float, float] | None
    frames_in_band_percent: float | None
    nis: float | None
    landmark_anees: float | None
    landmark_rmse_m: float | None
    ms_per_frame: float | None
    gated_percent: float | None
    rejected: int
    behind_camera: int
    failed_factorisations: int
    diverged: int
    failures: tuple[str, ...]
