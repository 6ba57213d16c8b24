"""Motion over windows of any trajectory: how its error grows with their length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import nees
from filters.checks.consistency import are_definite, chi_square_quantile
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.windows import window_ends
from stereo_slam_env.recording.drift import adjoints
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors, tangent_jacobian, transformed

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
    own, lasting = transformed(J, drift.own), J @ drift.lasting
    grown = P - own - lasting @ lasting.swapaxes(1, 2)
    left = lasting[last] - back @ lasting[first]
    increments = grown[last] - transformed(back, grown[first])
    found: FloatArray = increments + left @ left.swapaxes(1, 2) + own[last] + transformed(back, own[first])
    return found
