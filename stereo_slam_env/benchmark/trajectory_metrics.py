"""How far a trajectory is from another one: pure functions of positions and orientations.

Rows are paired: row k of both trajectories belongs to the same instant. Rows with NaN must be removed first.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters.validation import FloatArray, finite_array


def align_rigid(estimate: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation and translation (no scale) that bring `estimate` nearest to `reference`.

    Source: Umeyama, PAMI 1991, with the scale held at 1.

    Parameters
    ----------
    estimate, reference : (K, 3) array_like
        Positions, m.

    Returns
    -------
    R : (3, 3) ndarray
    t : (3,) ndarray
        So that R @ estimate + t is near `reference`.

    Raises
    ------
    ValueError
        Fewer than 3 positions, or they lie on one line (within rounding): the rotation is then not determined.
    """
    R, t, singular_values = _least_squares_motion(*_paired(estimate, reference))
    if singular_values[1] <= 1e-12 * max(singular_values[0], np.finfo(float).tiny):
        raise ValueError("estimate and reference cannot be aligned: the positions lie on one line or one point")
    return R, t


def ate_rigid(estimate: FloatArray, reference: FloatArray) -> float:
    """Root mean square distance after the best rigid motion without scale, m.

    Defined for positions on a line too: the motion is then not unique, but its residual is.
    """
    estimate, reference = _paired(estimate, reference)
    R, t, _ = _least_squares_motion(estimate, reference)
    return root_mean_square(estimate @ R.T + t - reference)


def ate_unaligned(estimate: FloatArray, reference: FloatArray) -> float:
    """Root mean square distance as it is: both trajectories start at the same known pose, m."""
    estimate, reference = _paired(estimate, reference)
    return root_mean_square(estimate - reference)


def path_length(positions: FloatArray) -> float:
    """Length of the way along (K, 3) positions, m."""
    return float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())


def end_drift_percent(estimate: FloatArray, reference: FloatArray) -> float:
    """Distance between the last positions, without alignment, in percent of the reference's path length.

    Raises
    ------
    ValueError
        The reference does not move.
    """
    estimate, reference = _paired(estimate, reference)
    length = path_length(reference)
    if length == 0.0:
        raise ValueError("reference does not move: drift in percent of the path is not defined")
    return float(100.0 * np.linalg.norm(estimate[-1] - reference[-1]) / length)


def rotation_errors(estimate: FloatArray, reference: FloatArray) -> FloatArray:
    """Angle between the orientations of each row; (K, 4), (K, 4) xyzw -> (K,) rad."""
    return np.asarray((Rotation.from_quat(estimate).inv() * Rotation.from_quat(reference)).magnitude())


def root_mean_square(errors: FloatArray) -> float:
    """Root of the mean squared length of (K, n) vectors or (K,) numbers."""
    squared = np.square(errors)
    return float(np.sqrt(np.mean(squared.sum(axis=1) if squared.ndim == 2 else squared)))


def _least_squares_motion(estimate: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    mean_estimate, mean_reference = estimate.mean(axis=0), reference.mean(axis=0)
    covariance = (reference - mean_reference).T @ (estimate - mean_estimate)
    U, singular_values, Vt = np.linalg.svd(covariance)
    handedness = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = (U * handedness) @ Vt
    return R, mean_reference - R @ mean_estimate, singular_values


def _paired(estimate: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    estimate = finite_array("estimate", estimate, ("K", 3))
    reference = finite_array("reference", reference, ("K", 3))
    if len(estimate) != len(reference):
        raise ValueError(f"estimate and reference must be paired: {len(estimate)} and {len(reference)} positions")
    if len(estimate) < 3:
        raise ValueError(f"estimate and reference must have at least 3 positions, got {len(estimate)}")
    return estimate, reference
