"""Results of filters: the time series of one run, and the summary of all runs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib import import_module
from typing import Any

import numpy as np

from filters.validation import FloatArray, IntArray
from stereo_slam_env.evaluation.landmark_statistics import DepthConvergence, LandmarkStatistics, RangeError
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace
from stereo_slam_env.recording.recording import GIVEN_TRUTH, NO_REFERENCE, Reference

EVENTS = ("updated", "initialised", "dropped", "gated", "rejected", "behind_camera")
MEGABYTE = 2.0**20
COUNTS = (*EVENTS, "failed_factorisations", "negative_depth", "landmarks_not_scored", "map_size")


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
        landmarks seen in the frame and estimated at d <= 0, landmarks in view without a NEES, and the size of the map.
    traces : tuple of LandmarkTrace
        Depth histories of a near and a far landmark, the same ids for every filter of a recording.
    not_given : mapping of str to str
        Options common to the filters of a comparison that this one was not given, and why.
    failure : str, optional
        One line when the filter raised or broke its contract; arrays are NaN from there on.
    position_nees, rotation_nees : (K,)
        NEES of the two halves of `pose_errors` with their blocks of the covariance (3 degrees of freedom each).
    predict_milliseconds, update_milliseconds : (K,)
        The two parts of `milliseconds`.
    state_size : (K,)
        Dimension of the error state; NaN for filters without a `state_size`.
    pose_nees_floor : (K,)
        Where errors of the reference are stated: the pose NEES that a consistent filter with this covariance would have
        if they were taken for its own.
    window_nees_1s, window_nees_10s : (K,)
        NEES of the motion over the window that ends at the frame (6 degrees of freedom); NaN elsewhere, and where
        windows were not scored.
    window_nees_1s_floor, window_nees_10s_floor : (K,)
        As `pose_nees_floor`, of these.
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
    pose_nees_floor: FloatArray = field(default_factory=_not_given)
    window_nees_1s: FloatArray = field(default_factory=_not_given)
    window_nees_1s_floor: FloatArray = field(default_factory=_not_given)
    window_nees_10s: FloatArray = field(default_factory=_not_given)
    window_nees_10s_floor: FloatArray = field(default_factory=_not_given)
    memory_mb: float = float("nan")
    landmark_statistics: LandmarkStatistics = field(default_factory=LandmarkStatistics)
    truth_from: Reference = GIVEN_TRUTH

    def __post_init__(self) -> None:
        for series in fields(self):
            if series.default_factory is _not_given and len(getattr(self, series.name)) == 0:  # not given: not known
                object.__setattr__(self, series.name, np.full(len(self.timestamps), np.nan))

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def reference(self) -> Reference:
        """Reference of the errors: `truth_from`, or none where no frame has a truth."""
        return self.truth_from if np.isfinite(self.true_positions).any() else NO_REFERENCE


@dataclass(frozen=True)
class SegmentError:
    """Relative error over the segments of one length, as KITTI measures it."""

    length_m: float  # length of the segments along the true path
    segments: int  # how many there were, over all runs
    # Means over the segments.
    translation_percent: float
    rotation_deg_per_100m: float


@dataclass(frozen=True)
class ConsistencyFigure:
    """A mean NEES or NIS against what a consistent filter has."""

    mean: float  # over frames and runs; `dof` is ideal
    dof: float  # degrees of freedom of one value
    # Two-sided 95 % band of the mean over this number of runs (of innovations, for NIS), see `consistency_figures`.
    band: tuple[float, float]
    inside_percent: float  # share of the frames whose mean over runs lies inside the band of that frame
    runs: int  # how many have it


@dataclass(frozen=True)
class FilterSummary:
    """Figures of one filter over all its runs: one row of the result table, one entry of `summary.json`.

    Every figure of `evaluation.figures` that is combined over runs is an attribute, too: `summary.position_rmse_m`.
    It is None (JSON null) where it does not apply (no truth, one run, ...).

    Attributes
    ----------
    filter_name : str
        Label.
    options : mapping
        Options the filter was made with.
    runs : int
        Number of recordings.
    figures : mapping of str to float or None
        Figures over runs by name, in the order of the table.
    position_rmse_by_run, efficiency_by_run : tuple of float
        Those figures of each run; NaN where not known. Of the efficiency empty without any bound.
    pose_anees_band : pair of float, optional
        Two-sided 95 % band of the mean pose NEES over this number of runs.
    consistency : mapping of str to ConsistencyFigure
        "pose", "position", "rotation", "landmark", "nis"; what is not known is left out.
    rpe : tuple of SegmentError
        By segment length, ascending.
    landmark_by_range : tuple of RangeError
        Ascending.
    depth_convergence : tuple of DepthConvergence
        Near, then far.
    failures : tuple of str
        One line for each run that raised.
    not_given : mapping of str to str
        Options common to all filters that this one was not given, and why.
    """

    filter_name: str
    options: Mapping[str, Any]
    runs: int
    figures: Mapping[str, float | None]
    position_rmse_by_run: tuple[float, ...] = ()
    efficiency_by_run: tuple[float, ...] = ()
    pose_anees_band: tuple[float, float] | None = None
    consistency: Mapping[str, ConsistencyFigure] = field(default_factory=dict)
    rpe: tuple[SegmentError, ...] = ()
    landmark_by_range: tuple[RangeError, ...] = ()
    depth_convergence: tuple[DepthConvergence, ...] = ()
    failures: tuple[str, ...] = ()
    not_given: Mapping[str, str] = field(default_factory=dict)

    def __getattr__(self, name: str) -> float | None:
        figures: Mapping[str, float | None] = vars(self).get("figures", {})  # none yet while it is unpickled
        if name not in figures:
            raise AttributeError(f"{type(self).__name__} has no figure {name!r}; it has {', '.join(figures)}")
        return figures[name]

    def as_dict(self) -> dict[str, Any]:
        """The entry of `summary.json`: every figure and attribute by name, but for the label."""
        fields = asdict(self)
        del fields["filter_name"]
        return {**fields.pop("figures"), **fields}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Common options that this filter was not given, a sentence each."""
        return tuple(
            f"{self.filter_name} does not get the common {option}: {reason}."
            for option, reason in self.not_given.items()
        )


def peak_memory_mb() -> float:
    """Largest resident memory this process has ever had, MB (2^20 bytes); NaN where the system does not tell.

    The difference of two calls is what the work between them added to the peak: the memory it needed, if the process
    has not had as much before.
    """
    try:
        resource = import_module("resource")
    except ImportError:  # Windows
        return float("nan")
    peak = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return peak / MEGABYTE if sys.platform == "darwin" else peak * 1024.0 / MEGABYTE
