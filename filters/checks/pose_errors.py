"""Error of a filter's pose against a truth that the filter is not shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from filters.checks.consistency import are_definite
from filters.contract.beliefs import PoseBelief
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import finite_array, unit_quaternion
from filters.errors.invariant import LeftInvariant, RightInvariant
from filters.errors.model import ErrorDefinition
from filters.errors.standard import QuaternionError, RotationVectorError
from filters.geometry import differences, rotations
from filters.geometry.arrays import FloatArray
from filters.motions.model import CameraState

DEFINITIONS: tuple[ErrorDefinition, ...] = (RotationVectorError(), QuaternionError(), RightInvariant(), LeftInvariant())
"""Definitions that a filter's `pose_error` is recognised as."""
_PROBE = np.array([0.13, -0.07, 0.31, 0.05, -0.08, 0.03])
"""Error of the pose at which definitions are told apart: they differ by 1e-5 there, and by rounding 1e-12."""
_ALIKE = 1e-9
LARGEST_DIFFERENCE = 1e-3
"""Share by which the covariance of `pose_error` may differ from that of `pose`."""


class InconsistentPoseError(ArithmeticError):
    """`pose_error` is no error of the pose that `pose` states."""


def blind_pose_error(slam: StereoFilter, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Error of a filter's pose in its own definition and its covariance, without showing the filter the true pose.

    `pose_error` is asked for errors near the estimate alone. Where it answers as one of `DEFINITIONS`, the error is
    computed by that. Any other definition is taken to first order: its Jacobian times the error of `PoseBelief`.

    Parameters
    ----------
    slam : StereoFilter
        The filter.
    position : (3,)
        True r^WC, m.
    orientation : (4,)
        True q^WC, xyzw.

    Returns
    -------
    error : (6,) ndarray
        Position part, then rotation part; NaN where the pose is not finite.
    covariance : (6, 6) ndarray
        The covariance that the filter claims for it.

    Raises
    ------
    InconsistentPoseError
        `pose_error` is not zero at the estimate, or its covariance is not that of `pose`.
    """
    truth = finite_array("position", position, (3,)), unit_quaternion("orientation", orientation)
    pose = slam.pose
    if not (np.isfinite(pose.position).all() and np.isfinite(pose.orientation).all()):
        return np.full(6, np.nan), pose.covariance
    camera = CameraState(pose.position, pose.orientation, np.zeros(3), np.zeros(3))
    probe, rounding = _moved(pose, _PROBE), _ALIKE * (1.0 + np.abs(pose.position).max())
    answer, claimed = _answer(slam, *probe)
    for definition in DEFINITIONS:
        expected, covariance = definition.pose_error(camera, pose.covariance, *probe)
        if np.abs(answer - expected).max() <= rounding:
            error, judged = definition.pose_error(camera, pose.covariance, *truth)
            break
    else:
        (none, claimed), J = _answer(slam, pose.position, pose.orientation), error_jacobian(slam)
        if not np.abs(none).max() <= 1e3 * rounding:
            raise InconsistentPoseError(f"its pose_error of its own pose is not zero but {_shown(none)}")
        error, _ = RotationVectorError().pose_error(camera, pose.covariance, *truth)
        error, covariance = J @ error, J @ pose.covariance @ J.T
        judged = claimed
    if not (are_definite(claimed) and are_definite(pose.covariance)):
        return error, claimed  # the contract says what is wrong with it, or it is that of a start that is known
    if not _alike(claimed, covariance):
        raise InconsistentPoseError(
            "its pose_error has another covariance than its pose: standard deviations "
            f"{_shown(np.sqrt(np.diagonal(claimed)))} instead of {_shown(np.sqrt(np.diagonal(covariance)))}"
        )
    return error, judged


def error_jacobian(slam: StereoFilter) -> FloatArray:
    """J (6, 6) that takes small pose errors as of `PoseBelief` to those of the filter's own definition."""
    pose = slam.pose
    return differences.jacobian(lambda delta: slam.pose_error(*_moved(pose, delta))[0], 6)


def _moved(pose: PoseBelief, delta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and orientation with an error as of `PoseBelief`."""
    return pose.position + delta[:3], rotations.multiply(pose.orientation, rotations.exp_quaternion(delta[3:]))


def _answer(slam: StereoFilter, position: FloatArray, orientation: FloatArray) -> tuple[FloatArray, FloatArray]:
    error, covariance = (np.asarray(values, dtype=np.float64) for values in slam.pose_error(position, orientation))
    if error.shape != (6,) or covariance.shape != (6, 6):
        raise InconsistentPoseError(f"its pose_error has shapes {error.shape} and {covariance.shape}: (6,) and (6, 6)")
    return error, covariance


def _alike(a: FloatArray, b: FloatArray) -> bool:
    sigmas = np.sqrt(np.abs(np.diagonal(b)))
    return bool((np.abs(a - b) <= LARGEST_DIFFERENCE * np.outer(sigmas, sigmas)).all())


def _shown(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"
