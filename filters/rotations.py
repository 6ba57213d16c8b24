"""SO(3): quaternions (xyzw), rotation vectors and their Jacobians.

Conversions are scipy's; this module adds what an EKF needs on top. A perturbation always acts on the right,
in the camera frame: R(q) Exp(delta), where R_wc = R(q).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from filters.validation import FloatArray


def skew(vector: ArrayLike) -> FloatArray:
    """Cross-product matrix [a]x, so that [a]x b = a x b; (..., 3) -> (..., 3, 3)."""
    a = np.asarray(vector, dtype=np.float64)
    matrix = np.zeros((*a.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -a[..., 2], a[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = a[..., 2], -a[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -a[..., 1], a[..., 0]
    return matrix


def matrix(quaternion: ArrayLike) -> FloatArray:
    """Rotation matrix of a unit quaternion xyzw; (4,) -> (3, 3)."""
    return np.asarray(Rotation.from_quat(quaternion).as_matrix())


def exp(rotation_vector: ArrayLike) -> FloatArray:
    """Rotation matrix Exp(phi); (3,) rad -> (3, 3)."""
    return np.asarray(Rotation.from_rotvec(rotation_vector).as_matrix())


def log(rotation_matrix: ArrayLike) -> FloatArray:
    """Rotation vector Log(R), of length in [0, pi]; (3, 3) -> (3,) rad."""
    return np.asarray(Rotation.from_matrix(rotation_matrix).as_rotvec())


def exp_quaternion(rotation_vector: ArrayLike) -> FloatArray:
    """The quaternion q(phi) of Eq. 6; (3,) rad -> (4,) xyzw."""
    return np.asarray(Rotation.from_rotvec(rotation_vector).as_quat())


def multiply(left: ArrayLike, right: ArrayLike) -> FloatArray:
    """Quaternion product left x right, normalised; (4,), (4,) xyzw -> (4,)."""
    x, y, z, w = np.asarray(left, dtype=np.float64)
    a, b, c, d = np.asarray(right, dtype=np.float64)
    product = np.array(
        [
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        ]
    )
    normalised: FloatArray = product / np.linalg.norm(product)
    return normalised


def between(q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
    """The quaternion dq with q_to = q_from x dq, scalar part >= 0; (4,), (4,) -> (4,)."""
    dq = multiply(np.asarray(q_from, dtype=np.float64) * [-1.0, -1.0, -1.0, 1.0], q_to)
    return dq if dq[3] >= 0 else -dq


def right_jacobian(rotation_vector: ArrayLike) -> FloatArray:
    """J_r(phi) of Exp(phi + d) = Exp(phi) Exp(J_r d) + O(d^2); (3,) -> (3, 3).

    The two coefficients are even functions of the angle; below 1e-4 rad their series is exact to rounding.
    """
    phi = np.asarray(rotation_vector, dtype=np.float64)
    square = float(phi @ phi)
    if square < 1e-8:
        first, second = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        angle = np.sqrt(square)
        first, second = (1.0 - np.cos(angle)) / square, (angle - np.sin(angle)) / (square * angle)
    cross = skew(phi)
    jacobian: FloatArray = np.eye(3) - first * cross + second * (cross @ cross)
    return jacobian
