"""Input of the figures: one run and its trajectories, all runs of a filter, and intermediate results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np

from filters.contract.outputs import PoseBelief, UpdateReport
from filters.geometry.arrays import BoolArray, FloatArray
from filters.monitor import Alarm, DivergenceMonitor
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.bands import consistency_figures
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.results import ConsistencyFigure, FilterRun
from stereo_slam_env.evaluation.trajectory_metrics import SegmentErrors
from stereo_slam_env.recording.trajectory import Tangent, Trajectory, pose_errors, tangent_jacobian, transformed

BODY = "left_camera"


def estimate_of(run: FilterRun) -> Trajectory | None:
    """The estimated poses, with their covariances for the filter's own error; None where there are none."""
    finite = _finite(run.positions, run.orientations, run.pose_covariances)
    if not finite.any():
        return None
    positions, orientations = run.positions[finite], run.orientations[finite]
    tangent = tangent_of(run)
    J = tangent_jacobian(tangent, positions, orientations)
    covariances = transformed(J, run.pose_covariances[finite])
    return Trajectory(positions, orientations, run.timestamps[finite], covariances, tangent, run.filter_name, body=BODY)


def truth_of(run: FilterRun) -> Trajectory | None:
    """The true poses; None where there are none."""
    finite = _finite(run.true_positions, run.true_orientations)
    if not finite.any():
        return None
    return Trajectory(
        run.true_positions[finite], run.true_orientations[finite], run.timestamps[finite], name="truth", body=BODY
    )


def reference_of(run: FilterRun) -> Trajectory | None:
    """The true poses that are scored, and the first one, with the errors that are stated of them."""
    truth = truth_of(run)
    if truth is None or truth.timestamps is None:
        return None
    stated = run.truth_from
    at = stated.has_settled(truth.timestamps)
    at[0] = True
    truth = truth.rows(at)
    if stated.is_exact:
        return truth
    start = truth.pose(0)
    covariances = np.array([stated.covariance(start, truth.pose(row)) for row in range(len(truth))])
    return replace(truth, covariances=covariances)


def tangent_of(run: FilterRun) -> Tangent:
    """Definition of the error that the run's `pose_errors` are of; without any, that of `PoseBelief`."""
    finite = _finite(run.positions, run.orientations, run.true_positions, run.true_orientations, run.pose_errors)
    if not finite.any():
        return "position-rotation"
    poses = (run.positions, run.orientations, run.true_positions, run.true_orientations)

    def difference(tangent: Tangent) -> float:
        errors = pose_errors(tangent, *(part[finite] for part in poses))
        return float(np.abs(errors - run.pose_errors[finite]).max())

    return min(get_args(Tangent), key=difference)


def _finite(*series: FloatArray) -> BoolArray:
    """Frames in which all of these are known, (K,)."""
    return np.asarray(np.all([np.isfinite(one.reshape(len(one), -1)).all(axis=1) for one in series], axis=0))


FEWEST_FRAMES = 3  # an alignment needs so many
_COUNTED = {
    **{name: name for name in ("updated", "initialised", "dropped", "gated", "behind_camera")},
    "failed": "failed_factorisations",
}
"""Field of `UpdateReport` with ids: the series of a run that counts them."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One run, with the intermediate results that several of its figures need.

    The first frame only initialises and is not scored, nor are frames without truth.
    """

    run: FilterRun
    # The run diverged if it ends farther from the truth than this share of the distance travelled.
    divergence_percent: float
    # Theoretical limit on its recording, one entry a frame; another number is refused with a `ValueError`.
    bound: Bound | None = None

    def __post_init__(self) -> None:
        if self.bound is not None and len(self.bound.pose) != len(self.run):
            raise ValueError(
                f"bound must have one entry a frame: {len(self.bound.pose)} entries, {len(self.run)} frames"
            )

    @cached_property
    def scored(self) -> BoolArray:
        """Frames with a finite position and a truth that has settled, but for the first; (K,)."""
        finite = np.array(
            np.isfinite(self.run.positions).all(axis=1) & np.isfinite(self.run.true_positions).all(axis=1)
        )
        finite[:1] = False
        return finite & self.run.truth_from.has_settled(self.run.timestamps)

    @cached_property
    def not_scored(self) -> int:
        """Number of frames with a truth that counts and has settled, and no pose NEES, but for the first."""
        run = self.run
        judged = np.array(np.isfinite(run.true_positions).all(axis=1) & run.truth_from.has_settled(run.timestamps))
        judged[:1] = False
        missing = judged & ~np.isfinite(run.pose_nees)
        return int(np.count_nonzero(missing)) if run.reference.counts_as_truth else 0

    @cached_property
    def positions(self) -> tuple[FloatArray, FloatArray] | None:
        """Estimated and true positions of the scored frames; None where they are fewer than `FEWEST_FRAMES`."""
        if self.scored.sum() < FEWEST_FRAMES:
            return None
        return self.run.positions[self.scored], self.run.true_positions[self.scored]

    @cached_property
    def position_rmse(self) -> float:
        """Root mean square position error, m, not aligned."""
        return float("nan") if self.positions is None else metrics.ate_unaligned(*self.positions)

    @cached_property
    def end_drift_percent(self) -> float:
        """Final position error by the length of the path; NaN where the vehicle stands still."""
        moved = self.positions is not None and metrics.path_length(self.positions[1]) > 0
        return metrics.end_drift_percent(*self.positions) if self.positions and moved else float("nan")

    @cached_property
    def segments(self) -> SegmentErrors:
        """Relative errors over the scored frames; none of a run that failed."""
        run, at = self.run, self.scored if self.run.failure is None else np.zeros(len(self.run), dtype=bool)
        estimate, truth = (run.positions[at], run.orientations[at]), (run.true_positions[at], run.true_orientations[at])
        return metrics.segment_errors(*estimate, *truth)

    @cached_property
    def final_covariance(self) -> FloatArray | None:
        """Pose covariance in the last scored frame that has one; without truth, in the last frame that has one."""
        claims = np.isfinite(self.run.pose_covariances).all(axis=(1, 2))
        last = np.flatnonzero(claims & self.scored if self.scored.any() else claims)[-1:]
        return self.run.pose_covariances[last[0]] if len(last) else None

    def bound_rmse(self, part: slice) -> float:
        """Root mean square bound of `POSITION`, m, or `ROTATION`, rad, over the scored frames."""
        if self.bound is None or not self.scored.any():
            return float("nan")
        return float(np.sqrt(np.mean(np.trace(self.bound.pose[self.scored, part, part], axis1=1, axis2=2))))

    @cached_property
    def alarm(self) -> Alarm | None:
        """First alarm of the divergence monitor, by innovations and events alone; its time is from the first frame on.

        What the filter did after it failed is not looked at. A trajectory from outside has nothing to be watched.
        """
        run, monitor = self.run, DivergenceMonitor()
        if not np.isfinite(run.linear_velocities).any():  # poses from outside: no filter has run
            return None
        for k, dt in enumerate(np.diff(run.timestamps, prepend=run.timestamps[:1])):
            if not np.isfinite(run.positions[k]).all():
                break
            ids = {name: np.arange(run.counts[series][k]) for name, series in _COUNTED.items() if series in run.counts}
            report = UpdateReport(**ids, nis=float(run.nis[k]), nis_dof=int(run.nis_dof[k]))
            pose = PoseBelief(run.positions[k], run.orientations[k], run.pose_covariances[k])
            if monitor.look(max(float(dt), 0.0), report, pose) is not None:
                break
        return monitor.alarm


def position_rmse(run: FilterRun) -> float:
    """Root mean square position error of a run, m; NaN where there is none."""
    return float("nan") if run.failure is not None else Trial(run, np.inf).position_rmse


@dataclass(frozen=True, eq=False)
class Sample:
    """The runs of one filter with their figures."""

    runs: Sequence[FilterRun]  # one a recording
    rows: Sequence[Mapping[str, Any]]  # the figures of each
    segments: SegmentErrors  # of all runs together

    @cached_property
    def completed(self) -> list[FilterRun]:
        """The runs that did not fail."""
        return [run for run in self.runs if run.failure is None]

    @cached_property
    def consistency(self) -> dict[str, ConsistencyFigure]:
        """NEES and NIS against their bands."""
        return consistency_figures(self.completed)

    def column(self, name: str) -> FloatArray:
        """A figure of each run; NaN where not known."""
        values = [row.get(name) for row in self.rows]
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    def known(self, name: str) -> FloatArray:
        """A figure of the runs in which it is known."""
        values = self.column(name)
        return values[np.isfinite(values)]
