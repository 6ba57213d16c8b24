"""NEES of poses and its quantiles, pose errors against a truth, and the test whether a claim is a covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from filters.contract.outputs import PoseBelief
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import finite_array, unit_quaternion
from filters.errors import ErrorDefinition, LeftInvariant, QuaternionError, RightInvariant, RotationVectorError
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.motions.motion_model import CameraState

ROUNDING = 1e-9
"""By so much of its size a covariance may be asymmetric, or semi-definite from the wrong side."""
NEGLIGIBLE = 1e-12
"""Variance (SI units) of a quantity that is known: 1e-6 squared. What is less below zero is rounding, too."""
LEAST_CORRELATION = 1e-14
"""Smallest eigenvalue of a correlation that is not rounding; those of the filters of this package are above 1e-2."""
CLEARLY = 1e-6
"""Determinant of a correlation far from any rounding."""
_SMALLEST = 1e-300


def nees(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Normalised estimation error squared e^T P^-1 e (Bar-Shalom, Li and Kirubarajan, 2001, ch. 5.4).

    Parameters
    ----------
    errors : (..., n) ndarray
        Estimation errors.
    covariances : (..., n, n) ndarray
        What the filter claims for them.

    Returns
    -------
    (...) ndarray
        NaN where the covariance is not symmetric positive definite or something is not finite.
    """
    errors, covariances = np.asarray(errors), np.asarray(covariances)
    usable = np.isfinite(errors).all(axis=-1) & are_definite(covariances)
    values = np.full(errors.shape[:-1], np.nan)
    solved = np.linalg.solve(covariances[usable], errors[usable][..., None])[..., 0]
    values[usable] = np.sum(errors[usable] * solved, axis=-1)
    return values


def chi_square_quantile(probability: float, dof: int) -> float:
    """Value that the NEES of a consistent filter stays below with `probability`.

    That of `scipy.stats.chi2.ppf`, to the bit, without `scipy.stats`, whose import takes as long as all others.
    """
    return float(2.0 * gammaincinv(dof / 2, probability))


def are_definite(covariances: FloatArray) -> BoolArray:
    """Mask (...) of matrices (..., n, n) that are finite, symmetric and positive definite, whatever their units."""
    usable = np.asarray(np.isfinite(covariances).all(axis=(-2, -1)))
    usable[usable] = _asymmetry(covariances[usable]) <= ROUNDING
    open_ones = usable & ~_are_clearly_definite(covariances)
    usable[open_ones] = _least_correlation(covariances[open_ones]) > LEAST_CORRELATION
    return usable


def _are_clearly_definite(covariances: FloatArray) -> BoolArray:
    """Mask (...) of matrices (..., 3, 3) that are definite beyond doubt, by the determinant of their correlation.

    There are many of them, and eigenvalues take long. Those of a correlation add up to 3, so that the smallest is at
    least det / 2.25. Of matrices of another size none is told.
    """
    if covariances.shape[-1] != 3:
        return np.zeros(covariances.shape[:-2], dtype=np.bool_)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        sigmas = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
        x, y, z = (covariances[..., i, j] / (sigmas[..., i] * sigmas[..., j]) for i, j in ((1, 0), (2, 0), (2, 1)))
        determinant = 1.0 + 2.0 * x * y * z - x * x - y * y - z * z
        is_clear: BoolArray = (np.abs(x) < 1.0) & (determinant > CLEARLY)
    return is_clear


def fault_of(covariance: FloatArray, *, definite: bool = True) -> str | None:
    """Fault that keeps (n, n) from being a covariance, or an example of (K, n, n), in words; None where nothing does.

    With `definite` False, a semi-definite one will do, such as that of a velocity that odometry without errors states.
    """
    if not np.isfinite(covariance).all():
        return "is not finite"
    if covariance.size == 0:
        return None
    asymmetry = float(_asymmetry(covariance).max())
    if asymmetry > ROUNDING:
        return f"is not symmetric (by {asymmetry:.2g} of its largest entry)"
    smallest = float(_least_correlation(covariance).min())
    if definite and not smallest > LEAST_CORRELATION:
        return f"is not positive definite (smallest eigenvalue, scaled to unit variances: {smallest:.2g})"
    if smallest < -ROUNDING and (smallest := float(np.linalg.eigvalsh(covariance).min())) < -NEGLIGIBLE:
        return f"is not positive semi-definite (smallest eigenvalue {smallest:.2g})"
    return None


def _asymmetry(covariances: FloatArray) -> FloatArray:
    """Largest difference of each from its transpose, by its largest entry."""
    largest = np.abs(covariances).max(axis=(-2, -1), initial=_SMALLEST)
    apart = np.abs(covariances - np.swapaxes(covariances, -1, -2)).max(axis=(-2, -1), initial=0.0)
    return np.asarray(apart / largest, dtype=np.float64)


def _least_correlation(covariances: FloatArray) -> FloatArray:
    """Smallest eigenvalue of each, scaled to unit variances, so that metres and radians compare; <= 0 where one is 0.

    A variance of 0 or less is taken as it is: its row is not scaled.
    """
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    sigmas = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    eigenvalues = np.linalg.eigvalsh(covariances / sigmas[..., :, None] / sigmas[..., None, :])
    return np.asarray(eigenvalues[..., 0], dtype=np.float64)


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
    return derivatives.jacobian(lambda delta: slam.pose_error(*_moved(pose, delta))[0], 6)


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
