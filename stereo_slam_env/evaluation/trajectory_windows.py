"""Motion over windows of any trajectory: how its error grows with their length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import nees
from filters.consistency import are_definite
from filters.geometry.poses import relative_jacobian
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from filters.validation import FloatArray
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.windows import window_ends
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors

LENGTHS = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Of windows, s."""


@dataclass(frozen=True)
class WindowScore:
    """Motion over windows of a length, which do not overlap, as seen from their first pose."""

    seconds: float
    """Their length."""
    windows: int
    """How many there are."""
    translation_rmse_m: float
    """m."""
    rotation_rmse_deg: float
    """Degrees."""
    least_nees: float | None
    """Mean NEES, 6 is ideal. A file does not say how the errors of two poses are correlated; taken as independent they
    make a difference too uncertain, so this is a lower bound. None without covariances, or where one is none."""


def score_windows(seconds: float, estimate: Trajectory, reference: Trajectory, times: FloatArray) -> WindowScore | None:
    """The score of paired trajectories over windows of a length; None where they are shorter."""
    ends = list(window_ends(times, seconds))
    if not ends:
        return None
    claimed, doubt = estimate.pose_covariances, reference.pose_covariances
    errors, covariances = np.zeros((len(ends), POSE_SIZE)), np.zeros((len(ends), POSE_SIZE, POSE_SIZE))
    for k, (i, j) in enumerate(ends):
        first, last = estimate.pose(i), estimate.pose(j)
        moved, truly = first.inverse() @ last, reference.pose(i).inverse() @ reference.pose(j)
        errors[k] = pose_errors(
            "position-rotation", *(a[None] for T in (moved, truly) for a in (T.position, T.orientation))
        )[0]
        if claimed is not None:
            both = np.zeros((2 * POSE_SIZE, 2 * POSE_SIZE))
            for at, row in enumerate((i, j)):
                own = slice(POSE_SIZE * at, POSE_SIZE * (at + 1))
                both[own, own] = claimed[row] + (0.0 if doubt is None else doubt[row])
            J = relative_jacobian(first, last)
            covariances[k] = J @ both @ J.T
    # The first pose may be known exactly: both start there.
    known = claimed is not None and are_definite(claimed[np.unique(ends)[1:]]).all()
    least = float(nees(errors, covariances).mean()) if known else float("nan")
    return WindowScore(
        seconds=seconds,
        windows=len(ends),
        translation_rmse_m=metrics.root_mean_square(errors[:, POSITION]),
        rotation_rmse_deg=float(np.rad2deg(metrics.root_mean_square(errors[:, ROTATION]))),
        least_nees=least if np.isfinite(least) else None,
    )
