"""What a filter did on a recording: the time series that metrics, store, plots and report share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from filters.validation import FloatArray, IntArray
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.recording.recording import GIVEN_TRUTH, NO_REFERENCE, Reference

EVENTS = ("updated", "initialised", "dropped", "gated", "rejected", "behind_camera")
COUNTS = (*EVENTS, "failed_factorisations", "negative_depth", "map_size")


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


def _not_given() -> FloatArray:
    return np.zeros(0)


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
        e^T P^-1 e of that error (6 degrees of freedom); NaN where the truth is not independent of the images.
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
        Those of `COUNTS`: what became of the measurements (`EVENTS`, as in `UpdateReport`), failed factorisations,
        landmarks seen in the frame and estimated at d <= 0, and the size of the map.
    traces : tuple of LandmarkTrace
        Depth histories of a near and a far landmark, the same ids for every filter of a recording.
    not_given : mapping of str to str
        Options common to the filters of a comparison that this one was not given, and why.
    failure : str, optional
        One line when the filter raised or returned nonsense; arrays are NaN from there on.
    position_nees, rotation_nees : (K,)
        NEES of the two halves of `pose_errors` with their blocks of the covariance (3 degrees of freedom each).
    predict_milliseconds, update_milliseconds : (K,)
        The two parts of `milliseconds`.
    state_size : (K,)
        Dimension of the error state; NaN for filters without a `state_size`.
    memory_mb : float
        By how much the run raised the peak resident memory of its process, MB (2^20 bytes), the recording not
        included. It is zero in a process that has needed more before, so compare trials that had a process of their
        own; NaN where the system does not tell (Windows).
    landmark_statistics : LandmarkStatistics
        Errors of the map by distance and age.
    truth_from : Reference
        What the truth is, where there is one.
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
    not_given: Mapping[str, str] = field(default_factory=dict)
    failure: str | None = None
    position_nees: FloatArray = field(default_factory=_not_given)
    rotation_nees: FloatArray = field(default_factory=_not_given)
    predict_milliseconds: FloatArray = field(default_factory=_not_given)
    update_milliseconds: FloatArray = field(default_factory=_not_given)
    state_size: FloatArray = field(default_factory=_not_given)
    memory_mb: float = float("nan")
    landmark_statistics: LandmarkStatistics = field(default_factory=LandmarkStatistics)
    truth_from: Reference = GIVEN_TRUTH

    def __post_init__(self) -> None:
        for name in ("position_nees", "rotation_nees", "predict_milliseconds", "update_milliseconds", "state_size"):
            if len(getattr(self, name)) == 0:  # not given: not known
                object.__setattr__(self, name, np.full(len(self.timestamps), np.nan))

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def reference(self) -> Reference:
        """What the estimates are held against: `truth_from`, or none where no frame has a truth."""
        return self.truth_from if np.isfinite(self.true_positions).any() else NO_REFERENCE


@dataclass(frozen=True)
class SegmentError:
    """Relative error over segments of one length, as KITTI measures it.

    Attributes
    ----------
    length_m : float
        Length of the segments along the true path.
    segments : int
        How many there were, over all runs.
    translation_percent, rotation_deg_per_100m : float
        Means over the segments.
    """

    length_m: float
    segments: int
    translation_percent: float
    rotation_deg_per_100m: float


@dataclass(frozen=True)
class RangeError:
    """Landmarks of one range of true distance from the camera, over frames and runs.

    Attributes
    ----------
    low_m, high_m : float
        The range; high_m is infinity for the last one.
    count : int
        Landmarks x frames.
    rmse_m : float
        Position error relative to the camera; estimates at d <= 0, or far beyond the truth, have no metric position and
        are left out, see `LandmarkStatistics`. NaN where nothing is left.
    depth_bias_m, depth_bias_sigma_m : float
        Mean of estimated minus true depth of the same ones (Sibley's bias), and its standard error over runs; that is
        NaN for a single run.
    anees : float
        Mean NEES in (u, v, d), 3 is ideal.
    """

    low_m: float
    high_m: float
    count: int
    rmse_m: float
    depth_bias_m: float
    depth_bias_sigma_m: float
    anees: float


@dataclass(frozen=True)
class DepthConvergence:
    """Depth of the landmarks that began near or far, by number of frames since they entered the map.

    Attributes
    ----------
    label : str
        "near" or "far".
    low_m, high_m : float
        True depth at first sight.
    frames : tuple of int
        Frames since then, 0 at first sight.
    count : tuple of int
        Landmarks still there.
    sigma_m, rmse_m : tuple of float
        Root mean square of the claimed standard deviation of depth, and of its true error, both to first order at the
        true depth, so that estimates at d <= 0 have theirs, too.
    """

    label: str
    low_m: float
    high_m: float
    frames: tuple[int, ...]
    count: tuple[int, ...]
    sigma_m: tuple[float, ...]
    rmse_m: tuple[float, ...]


@dataclass(frozen=True)
class ConsistencyFigure:
    """A mean NEES or NIS against what a consistent filter has.

    Attributes
    ----------
    mean : float
        Over frames and runs; `dof` is ideal.
    dof : float
        Degrees of freedom of one value.
    band : pair of float
        Two-sided 95 % band of the mean over this number of runs (of innovations, for NIS), see `consistency_figures`.
    inside_percent : float
        Share of the frames whose mean over runs lies inside the band of that frame.
    """

    mean: float
    dof: float
    band: tuple[float, float]
    inside_percent: float


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
        Mean over frames and runs of the pose NEES (6 degrees of freedom, so 6 is ideal; shown by 6), and the two-sided
        95 % chi-square band of the mean over this number of runs.
    frames_in_band_percent : float
        Share of the frames whose NEES, averaged over runs, lies inside the band.
    nis : float
        NIS per degree of freedom (1 is ideal).
    landmark_anees : float
        Landmark NEES in (u, v, d) space (3 is ideal; shown by 3), mean over landmarks, frames and runs.
    landmark_rmse_m : float
        Landmark error relative to the camera, median over frames and runs.
    ms_per_frame : float
        Median over frames of predict + update.
    gated_percent : float
        Share of known measurements gated, over all runs.
    rejected, behind_camera, failed_factorisations : int
        Event counts over all runs.
    diverged : int
        Runs that failed, returned non-finite numbers, or ended farther from the truth than the divergence limit.
    failures : tuple of str
        One line for each run that raised.
    not_given : mapping of str to str
        Options common to all filters that this one was not given, and why.
    bound_position_m, bound_rotation_deg : float
        Posterior Cramer-Rao bound of the position and the rotation RMSE on these recordings, see `benchmark.limits`.
    efficiency_percent : float
        `bound_position_m` over `position_rmse_m`: 100 leaves nothing to gain.
    efficiency_by_run : tuple of float
        The same of each run; NaN where not known.
    consistency : mapping of str to ConsistencyFigure
        "pose", "position", "rotation", "landmark", "nis"; what is not known is left out.
    rpe : tuple of SegmentError
        By segment length, ascending.
    rpe_translation_percent, rpe_rotation_deg_per_100m : float
        Means over the segments of all lengths: KITTI's t_rel and r_rel.
    landmark_by_range : tuple of RangeError
        Ascending.
    depth_convergence : tuple of DepthConvergence
        Near, then far.
    negative_depth : int
        Landmarks x frames with an estimate of d <= 0.
    ms_predict, ms_update : float
        Medians of the two calls.
    state_size : float
        Median dimension of the error state.
    memory_mb : float
        Largest growth of a trial's resident memory.
    end_error_m : float
        Root mean square of the position error in the last frame.
    final_position_sigma_m : float
        Root mean square of what the filter claims for it: of the root of the trace of the position's covariance.
    final_pose_logdet : float
        Natural logarithm of the determinant of that pose covariance (m and rad), mean over runs.
    alarmed : int
        Runs in which the divergence monitor raised an alarm, see `filters.monitor`.
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
    bound_position_m: float | None = None
    bound_rotation_deg: float | None = None
    efficiency_percent: float | None = None
    efficiency_by_run: tuple[float, ...] = ()
    consistency: Mapping[str, ConsistencyFigure] = field(default_factory=dict)
    rpe: tuple[SegmentError, ...] = ()
    rpe_translation_percent: float | None = None
    rpe_rotation_deg_per_100m: float | None = None
    landmark_by_range: tuple[RangeError, ...] = ()
    depth_convergence: tuple[DepthConvergence, ...] = ()
    negative_depth: int = 0
    ms_predict: float | None = None
    ms_update: float | None = None
    state_size: float | None = None
    memory_mb: float | None = None
    end_error_m: float | None = None
    final_position_sigma_m: float | None = None
    final_pose_logdet: float | None = None
    alarmed: int = 0
    not_given: Mapping[str, str] = field(default_factory=dict)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What sets this filter apart from the others, a sentence each."""
        return tuple(
            f"{self.filter_name} does not get the common {option}: {reason}."
            for option, reason in self.not_given.items()
        )
