"""Windows of a run or trajectory: the motion over some seconds, whose error does not hang on one early heading error.

A window needs the correlation of two poses. Filters that keep clones of the pose have it; the others are not scored.
Of any trajectory the error of motion grows with the length of its windows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from filters import Pose, PoseBelief, StereoFilter, nees
from filters.checks.consistency import are_definite, chi_square_quantile
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.results import check_motion
from stereo_slam_env.loop import Moment
from stereo_slam_env.recording.recording import Recording, Reference, adjoints
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors, tangent_jacobian, transformed

WINDOWS = (1.0, 10.0)
"""Lengths of the windows that are scored, s."""
_SAME_TIME = 1e-6  # s


def series_of(seconds: float) -> str:
    """Name of the series of a `FilterRun` with the NEES of windows of that length; with "_floor": its floor."""
    return f"window_nees_{seconds:g}s"


def window_ends(timestamps: FloatArray | Sequence[float], seconds: float) -> Iterator[tuple[int, int]]:
    """First and last rows of windows that do not overlap: each ends at the first row that is so much later."""
    first = 0
    for row, time in enumerate(timestamps):
        if time - timestamps[first] >= seconds - _SAME_TIME:
            yield first, row
            first = row


WINDOW_SERIES = tuple(series_of(seconds) + kind for seconds in WINDOWS for kind in ("", "_floor"))
"""The series of a `FilterRun` that `WindowScores` gives."""


@runtime_checkable
class Cloning(Protocol):
    """Interface of a filter for its windows to be scored, as `filters.StereoEKF` has it."""

    def clone_pose(self, name: str) -> None:
        """Keep the present pose under a name."""

    def forget_clone(self, name: str) -> None:
        """Drop the clone of that name."""

    def relative_pose(self, name: str) -> PoseBelief:
        """The present pose as seen from it."""


class WindowScores:
    """NEES of the motion over windows, frame by frame: a clone of the pose at the start of each, let go at its end.

    Clones change no estimate of a filter.

    Parameters
    ----------
    slam : StereoFilter
        The filter; one without clones has no windows.
    recording : Recording
        The stream; windows lie in its frames with a truth that has settled.

    Raises
    ------
    ContractBroken
        What a filter claims of a motion is no covariance.
    """

    def __init__(self, slam: StereoFilter, recording: Recording) -> None:
        self._recording, self._slam = recording, slam if isinstance(slam, Cloning) else None
        reference, count = recording.reference, len(recording)
        times = np.array([frame.timestamp for frame in recording.frames])
        known_truth = np.array([frame.truth is not None for frame in recording.frames]) & reference.has_settled(times)
        rows = np.flatnonzero(known_truth if reference.counts_as_truth else np.zeros(count, dtype=bool))
        self._ends = {s: {int(rows[j]): int(rows[i]) for i, j in window_ends(times[rows], s)} for s in WINDOWS}
        self._starts = {s: set(ends.values()) for s, ends in self._ends.items()}
        self.series = {name: np.full(count, np.nan) for name in WINDOW_SERIES if self._slam is not None}
        """(K,) by `series_of`: the NEES of the window that ends at a frame (6 degrees of freedom), NaN at the others;
        and with "_floor", where errors of the reference are stated, what a consistent filter would have without them.
        Nothing for a filter without clones."""
        self.open = 0
        """Clones that there are now."""

    def add(self, moment: Moment) -> None:
        """Note the windows that end at this frame, and begin those that start there."""
        k, slam = moment.number, self._slam
        if slam is None:
            return
        for seconds, first_of in self._ends.items():
            name = series_of(seconds)
            if k in first_of:
                start = self._recording.frames[first_of[k]].truth
                assert start is not None
                value, floor = _window_nees(slam.relative_pose(name), start, moment, self._recording.reference)
                self.series[name][k], self.series[name + "_floor"][k] = value, floor
                slam.forget_clone(name)
                self.open -= 1
            if k in self._starts[seconds]:
                slam.clone_pose(name)
                self.open += 1


def _window_nees(moved: PoseBelief, start: Pose, moment: Moment, reference: Reference) -> tuple[float, float]:
    """NEES of a motion against the true one, and its floor."""
    assert moment.truth is not None
    check_motion(moment.number, moved)
    true = start.inverse() @ moment.truth
    poses = (moved.position, moved.orientation, true.position, true.orientation)
    error = pose_errors("position-rotation", *(part[None] for part in poses))
    doubt = reference.relative_covariance(start, moment.truth)
    floor = float("nan") if reference.is_exact else float(nees_floor(moved.covariance, doubt))
    return float(nees(error, (moved.covariance + doubt)[None])[0]), floor


def nees_floor(claimed: FloatArray, reference: FloatArray) -> FloatArray:
    """Mean NEES (...) of a consistent filter that claims (..., n, n), against references with errors of (..., n, n).

    n + tr(P^-1 C): what it would be if the errors of the reference were taken for its own.
    """
    return np.asarray(claimed.shape[-1] + np.trace(np.linalg.solve(claimed, reference), axis1=-2, axis2=-1))


LENGTHS = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Of windows, s."""
_COVERED = 0.9
"""Probability of the ellipsoid whose coverage is counted."""


@dataclass(frozen=True)
class WindowScore:
    """Motion over windows of a length, which do not overlap, as seen from their first pose."""

    seconds: float
    """Their length."""
    windows: int
    """How many there are."""
    translation_rmse_m: float
    """Root mean square of the distance, m."""
    rotation_rmse_deg: float
    """Root mean square of the angle, degrees."""
    nees: float | None
    """Mean NEES, 6 is ideal. None without covariances, where one is none, and of claims in a plane."""
    nees_is_exact: bool
    """Whether the file says how the errors of two poses are correlated. If not, they are taken as independent, which
    makes a difference too uncertain, so the NEES is a lower bound."""
    coverage: float | None
    """Share of the windows inside the 90 % ellipsoid; None where the NEES is none, or not exact."""


def score_windows(seconds: float, estimate: Trajectory, reference: Trajectory, times: FloatArray) -> WindowScore | None:
    """The score of paired trajectories over windows of a length; None where they are shorter."""
    ends = list(window_ends(times, seconds))
    if not ends:
        return None
    first, last = np.array(ends).T
    moved, truly = (motions(one, first, last) for one in (estimate, reference))
    errors = pose_errors("right", *moved, *truly)
    value = covered = None
    covariances = motion_covariances(estimate, first, last) if estimate.plane is None else None
    if covariances is not None:
        if (doubt := motion_covariances(reference, first, last)) is not None:
            covariances = covariances + doubt
        claimed = estimate.covariances
        # The first pose may be known exactly: both start there.
        if claimed is not None and are_definite(claimed[np.unique(ends)[1:]]).all():
            values = nees(errors, covariances)
            if np.isfinite(values).all():
                limit = chi_square_quantile(_COVERED, POSE_SIZE)
                value, covered = float(values.mean()), float(np.mean(values <= limit))
    return WindowScore(
        seconds=seconds,
        windows=len(ends),
        translation_rmse_m=metrics.root_mean_square(truly[0] - moved[0]),
        rotation_rmse_deg=float(np.rad2deg(metrics.root_mean_square(errors[:, ROTATION]))),
        nees=value,
        nees_is_exact=estimate.drift is not None,
        coverage=covered if estimate.drift is not None else None,
    )


def motions(trajectory: Trajectory, first: IntArray, last: IntArray) -> tuple[FloatArray, FloatArray]:
    """Positions (W, 3) and orientations (W, 4) of the poses `last` (W,) as seen from the poses `first` (W,)."""
    R_first = rotations.matrix(trajectory.orientations[first])
    moved = rotations.turned(R_first.swapaxes(1, 2), trajectory.positions[last] - trajectory.positions[first])
    backwards = trajectory.orientations[first] * np.array([-1.0, -1.0, -1.0, 1.0])
    return moved, rotations.multiply(backwards, trajectory.orientations[last])


def motion_covariances(trajectory: Trajectory, first: IntArray, last: IntArray) -> FloatArray | None:
    """Covariances (W, 6, 6) of the errors Log(T^^-1 T) of motions; None where nothing is claimed.

    Where the trajectory says what the errors of two poses have in common (`Trajectory.drift`), they are that of the
    motion; else the errors of two poses are taken as independent, which makes them too large.
    """
    if (covariances := trajectory.covariances) is None:
        return None
    poses = trajectory.positions, trajectory.orientations
    J = tangent_jacobian("right", *poses) @ np.linalg.inv(tangent_jacobian(trajectory.tangent, *poses))
    P = transformed(J, covariances)
    moved, turned = motions(trajectory, first, last)
    back: FloatArray = np.linalg.inv(adjoints(moved, turned)).astype(
        np.float64
    )  # from errors in the first body to those in the last one
    if (drift := trajectory.drift) is None:
        return P[last] + transformed(back, P[first])
    own_part, lasting = transformed(J, drift.own), J @ drift.lasting
    grown = P - own_part - lasting @ lasting.swapaxes(1, 2)
    lasting_left = lasting[last] - back @ lasting[first]
    increments = grown[last] - transformed(back, grown[first])
    covariance: FloatArray = (
        increments + lasting_left @ lasting_left.swapaxes(1, 2) + own_part[last] + transformed(back, own_part[first])
    )
    return covariance
