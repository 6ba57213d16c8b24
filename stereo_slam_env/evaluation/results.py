"""Results of filters: the time series of one run, the summary of all runs, and the contract in every frame.

A frame without them is a failure of the run, like an exception: a NEES that cannot be computed must not be left out of
a mean as if the frame had not been driven. The pose must be positive definite from the second frame on: before the
first prediction it is what the filter was told at `reset`, which may be exact; and so must landmarks, as seen from it.
Velocities may be known exactly, from odometry without errors.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib import import_module
from typing import Any

import numpy as np

from filters import LandmarkBelief, PoseBelief
from filters.checks.consistency import are_definite, fault_of
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.evaluation.landmark_statistics import DepthConvergence, LandmarkStatistics, RangeError
from stereo_slam_env.evaluation.map_scoring import LandmarkTrace, MapScore, MapView
from stereo_slam_env.recording.recording import GIVEN_TRUTH, NO_REFERENCE, Reference

EVENTS = ("updated", "initialised", "dropped", "gated", "rejected", "behind_camera")
MEGABYTE = 2.0**20
COUNTS = (*EVENTS, "failed_factorisations", "negative_depth", "landmarks_not_scored", "map_size")


def _not_given() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class BodyScores:
    """Moving bodies of a filter, in the N frames x bodies in which landmarks on them are measured.

    The true body is the one that most of them are on. Poses, twists and speeds are scored from 1 s after birth.
    """

    frames: IntArray
    """(N,): number of the frame."""
    numbers: IntArray
    """(N,): number of the body in the filter."""
    at_birth: IntArray
    """(N,): true body at its birth, -1: none, it is a false one."""
    true_bodies: IntArray
    """(N,): true body in the frame, -1: none."""
    ages: FloatArray
    """(N,): time since birth, s."""
    pose_nees: FloatArray
    """(N,): of the motion since birth, as seen from the camera (6 degrees of freedom); NaN where it is not scored."""
    twist_nees: FloatArray
    """(N,): of velocity and angular velocity (6 degrees of freedom)."""
    speed_errors: FloatArray
    """(N,): estimated minus true speed, m/s."""
    positions: FloatArray
    """(N, 3): estimated, m, in W."""
    true_positions: FloatArray
    """(N, 3): where the true body at birth has taken that point."""
    covariances: FloatArray
    """(N, 3, 3): of the position, m^2."""
    velocities: FloatArray
    """(N, 3): estimated, m/s, in W."""
    delays: FloatArray
    """(B,): time from the first frame with four points on a true body to the birth of the first body for it, s."""

    @property
    def false_births(self) -> int:
        """Number of bodies that were none at birth."""
        return len(np.unique(self.numbers[self.at_birth < 0]))

    @property
    def swapped(self) -> FloatArray:
        """Whether a body is false, or on another true one than at birth, as 0 or 1, from 1 s after birth on."""
        wrong = (self.true_bodies != self.at_birth) | (self.at_birth < 0)
        return np.asarray(wrong[self.ages > 1.0 - 1e-9], dtype=np.float64)


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
    landmarks seen in the frame and estimated at d <= 0, landmarks in view without a NEES, and the size of the map; and
    those of `BodyScorer` where the recording tells the true moving bodies."""
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
    """Landmarks after the last frame; None in runs that were stored, or made in a batch."""
    bodies: BodyScores | None = None
    """Moving bodies; None of filters without, and where the true ones are not known."""

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


class ContractBroken(ArithmeticError):
    """A belief of a filter is none: "frame 12: its covariance is not positive definite"."""

    def __init__(self, frame: int, what: str) -> None:
        super().__init__(f"frame {frame}: {what}")
        self.frame = frame


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Beliefs of a filter in K frames."""

    values: Mapping[str, FloatArray]
    """(K, n) by name, for messages."""
    pose: FloatArray
    """(K, 6, 6): covariance."""
    velocity: FloatArray
    """(K, 6, 6): covariance."""
    errors: FloatArray
    """(K, 6): errors of the pose, where they are known."""
    claimed: FloatArray
    """(K, 6, 6): covariance claimed for them."""
    known: BoolArray
    """(K,): whether they are known."""

    def __getitem__(self, k: int) -> Beliefs:
        one = slice(k, k + 1)
        values = {name: value[one] for name, value in self.values.items()}
        return Beliefs(values, self.pose[one], self.velocity[one], self.errors[one], self.claimed[one], self.known[one])


def check_beliefs(first: int, beliefs: Beliefs) -> None:
    """Raise `ContractBroken` for the first frame in which pose, velocity or the error of the pose is none.

    The frames are numbered from `first` on.
    """
    sound = are_definite(beliefs.pose) & are_definite(beliefs.velocity)
    for value in beliefs.values.values():
        sound &= np.isfinite(value).all(axis=1)
    claimed = (beliefs.claimed == beliefs.pose).all(axis=(1, 2)) | are_definite(beliefs.claimed)
    sound &= ~beliefs.known | (claimed & np.isfinite(beliefs.errors).all(axis=1))
    for k in np.flatnonzero(~sound).tolist():  # perhaps they are semi-definite where they may be
        _check_frame(first + k, beliefs[k])


def _check_frame(k: int, belief: Beliefs) -> None:
    for name, value in belief.values.items():
        _require_finite(k, name, value)
    _require_covariance(k, "covariance", belief.pose[0], definite=k > 0)
    _require_covariance(k, "velocity covariance", belief.velocity[0], definite=False)
    if belief.known[0]:
        _require_finite(k, "pose error", belief.errors)
        if not np.array_equal(belief.claimed, belief.pose):
            _require_covariance(k, "covariance", belief.claimed[0], definite=k > 0, where=", as pose_error claims it")


def check_maps(view: MapView, score: MapScore) -> None:
    """Raise `ContractBroken` for the first frame in which the covariance of a landmark is none.

    Of those truly in view: the others are not scored. One without a finite place, such as one at infinity in XYZ, has
    none to be judged by. One that has a NEES has passed.
    """
    for place in np.flatnonzero(score.in_view & np.isnan(score.nees) & np.isfinite(view.uvd).all(axis=1)):
        frame, name = int(view.frames[place]), f"covariance of landmark {view.ids[place]}"
        _require_covariance(frame, name, view.covariance[place], definite=frame > 0)


def check_motion(frame: int, moved: PoseBelief) -> None:
    """Raise `ContractBroken` where the covariance of the motion over the window that ends here is none."""
    _require_covariance(frame, "covariance of the relative pose", moved.covariance, definite=True)


def _require_finite(frame: int, name: str, value: FloatArray) -> None:
    if not np.isfinite(value).all():
        raise ContractBroken(frame, f"its {name} is not finite")


def _require_covariance(frame: int, name: str, covariance: FloatArray, *, definite: bool, where: str = "") -> None:
    fault = fault_of(covariance, definite=definite)
    if fault is not None:
        raise ContractBroken(frame, f"its {name} {fault}{where}")
