"""Results of filters: the time series of one run, and the summary of all runs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib import import_module
from typing import Any

import numpy as np

from filters import LandmarkBelief
from filters.geometry.arrays import FloatArray, IntArray
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
    """One filter on one recording. K frames; per-frame arrays hold NaN where a quantity is unknown."""

    filter_name: str
    """Label of the filter."""
    recording_name: str
    """Label of what it ran on."""
    options: Mapping[str, Any]
    """Options the filter was made with (JSON-able)."""
    seed: int | None
    """Seed of the recording; None for real data."""
    timestamps: FloatArray
    """(K,): s."""
    positions: FloatArray
    """(K, 3): estimated r^WC, m."""
    orientations: FloatArray
    """(K, 4): estimated q^WC, xyzw."""
    pose_covariances: FloatArray
    """(K, 6, 6): of the `PoseBelief`."""
    linear_velocities: FloatArray
    """(K, 3): estimated, m/s in W."""
    angular_velocities: FloatArray
    """(K, 3): estimated, rad/s in the camera frame."""
    velocity_covariances: FloatArray
    """(K, 6, 6): of the `VelocityBelief`."""
    true_positions: FloatArray
    """(K, 3): NaN where there is no truth."""
    true_orientations: FloatArray
    """(K, 4): NaN where there is no truth."""
    true_linear_velocities: FloatArray
    """(K, 3): NaN where there is no truth."""
    true_angular_velocities: FloatArray
    """(K, 3): NaN where there is no truth."""
    pose_errors: FloatArray
    """(K, 6): the filter's own `pose_error`."""
    pose_nees: FloatArray
    """(K,): e^T P^-1 e of that error (6 degrees of freedom); NaN where the truth is not independent of the images."""
    landmark_nees: FloatArray
    """(K,): mean over the landmarks of the frame, in (u, v, d) space (3 degrees of freedom)."""
    landmark_rmse: FloatArray
    """(K,): root mean square position error of the landmarks of the frame relative to the camera, m."""
    nis: FloatArray
    """(K,): normalised innovation squared."""
    nis_dof: IntArray
    """(K,) int64: its degrees of freedom."""
    milliseconds: FloatArray
    """(K,): predict + update."""
    counts: Mapping[str, IntArray]
    """Those of `COUNTS`: what became of the measurements (`EVENTS`, as in `UpdateReport`), failed factorisations,
    landmarks seen in the frame and estimated at d <= 0, landmarks in view without a NEES, and the size of the map."""
    traces: tuple[LandmarkTrace, ...] = ()
    """Depth histories of a near and a far landmark, the same ids for every filter of a recording."""
    not_given: Mapping[str, str] = field(default_factory=dict)
    """Options common to the filters of a comparison that this one was not given, and why."""
    failure: str | None = None
    """One line when the filter raised or broke its contract; arrays are NaN from there on."""
    position_nees: FloatArray = field(default_factory=_not_given)
    """(K,): NEES of the position half of `pose_errors` with its block of the covariance (3 degrees of freedom)."""
    rotation_nees: FloatArray = field(default_factory=_not_given)
    """(K,): as `position_nees`, of the rotation."""
    predict_milliseconds: FloatArray = field(default_factory=_not_given)
    """(K,): part of `milliseconds`."""
    update_milliseconds: FloatArray = field(default_factory=_not_given)
    """(K,): the other part."""
    state_size: FloatArray = field(default_factory=_not_given)
    """(K,): dimension of the error state; NaN for filters without a `state_size`."""
    pose_nees_floor: FloatArray = field(default_factory=_not_given)
    """(K,): where errors of the reference are stated: the pose NEES that a consistent filter with this covariance would
    have if they were taken for its own."""
    window_nees_1s: FloatArray = field(default_factory=_not_given)
    """(K,): NEES of the motion over the window that ends at the frame (6 degrees of freedom); NaN elsewhere, and where
    windows were not scored."""
    window_nees_1s_floor: FloatArray = field(default_factory=_not_given)
    """(K,): as `pose_nees_floor`, of these."""
    window_nees_10s: FloatArray = field(default_factory=_not_given)
    """(K,): NEES of the motion over the window that ends at the frame (6 degrees of freedom); NaN elsewhere, and where
    windows were not scored."""
    window_nees_10s_floor: FloatArray = field(default_factory=_not_given)
    """(K,): as `pose_nees_floor`, of these."""
    memory_mb: float = float("nan")
    """By how much the run raised the peak resident memory of its process, MB (2^20 bytes), the recording not included.
    It is zero in a process that has needed more before, so compare trials that had a process of their own; NaN where
    the system does not tell (Windows)."""
    landmark_statistics: LandmarkStatistics = field(default_factory=LandmarkStatistics)
    """Errors of the map by distance and age."""
    truth_from: Reference = GIVEN_TRUTH
    """What the truth is, where there is one."""
    final_map: LandmarkBelief | None = None
    """Landmarks after the last frame; None where they are not kept, as in runs that were stored."""

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
    """

    filter_name: str
    """Label in tables."""
    options: Mapping[str, Any]
    """Options the filter was made with."""
    runs: int
    """Number of recordings."""
    figures: Mapping[str, float | None]
    """Figures over runs by name, in the order of the table."""
    position_rmse_by_run: tuple[float, ...] = ()
    """That figure of each run, m; NaN where not known."""
    efficiency_by_run: tuple[float, ...] = ()
    """Efficiency of each run; NaN where not known, empty without any bound."""
    pose_anees_band: tuple[float, float] | None = None
    """Two-sided 95 % band of the mean pose NEES over this number of runs."""
    consistency: Mapping[str, ConsistencyFigure] = field(default_factory=dict)
    """The "pose", "position", "rotation", "landmark", "nis"; what is not known is left out."""
    doubt: str = ""
    """What explains a NEES above its band other than the claim: calibration, frames or truth; empty where nothing."""
    rpe: tuple[SegmentError, ...] = ()
    """By segment length, ascending."""
    landmark_by_range: tuple[RangeError, ...] = ()
    """By distance from the camera, ascending."""
    depth_convergence: tuple[DepthConvergence, ...] = ()
    """Near, then far."""
    failures: tuple[str, ...] = ()
    """One line for each run that raised."""
    not_given: Mapping[str, str] = field(default_factory=dict)
    """Options common to all filters that this one was not given, and why."""

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
