"""SO(3): quaternions (xyzw), rotation vectors and their Jacobians.

A perturbation always acts on the right, in the camera frame: R(q) Exp(delta), where R_wc = R(q). A filter turns a
single camera some ten times a frame, so the closed forms are written out here, in Python floats for one rotation and in
arrays for many at once; the logarithm is scipy's.
"""

from __future__ import annotations

import math
from typing import Any

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
    """Rotation matrix of a unit quaternion xyzw; (..., 4) -> (..., 3, 3)."""
    x, y, z, w = _numbers(quaternion)
    return _array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def exp(rotation_vector: ArrayLike) -> FloatArray:
    """Rotation matrix Exp(phi); (..., 3) rad -> (..., 3, 3)."""
    return matrix(exp_quaternion(rotation_vector))


def log(rotation_matrix: ArrayLike) -> FloatArray:
    """Rotation vector Log(R), of length in [0, pi]; (3, 3) -> (3,) rad, or (M, 3, 3) -> (M, 3)."""
    return np.asarray(Rotation.from_matrix(rotation_matrix).as_rotvec())


def exp_quaternion(rotation_vector: ArrayLike) -> FloatArray:
    """The quaternion q(phi) of Eq. 6; (..., 3) rad -> (..., 4) xyzw."""
    x, y, z = _numbers(rotation_vector)
    # sin(half) / angle; its series below 1e-4 rad is exact to rounding.
    if isinstance(x, float):
        half = 0.5 * math.hypot(x, y, z)
        ratio = 0.5 * math.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
        return np.array([ratio * x, ratio * y, ratio * z, math.cos(half)])
    halves = 0.5 * np.sqrt(x * x + y * y + z * z)
    small = halves <= 1e-4
    safe = np.where(small, 1.0, halves)
    ratios = np.where(small, 0.5 - halves * halves / 12.0, 0.5 * np.sin(safe) / safe)
    return _array([ratios * x, ratios * y, ratios * z, np.cos(halves)])


def multiply(left: ArrayLike, right: ArrayLike) -> FloatArray:
    """Quaternion product left x right, normalised; (..., 4), (..., 4) xyzw -> (..., 4)."""
    x, y, z, w = _numbers(left)
    a, b, c, d = _numbers(right)
    product = (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )
    if isinstance(x, float):
        return np.array(product) / math.hypot(*product)
    products = _array(product)
    normalised: FloatArray = products / np.linalg.norm(products, axis=-1, keepdims=True)
    return normalised


def between(q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
    """The quaternion dq with q_to = q_from x dq, scalar part >= 0; (..., 4), (..., 4) -> (..., 4)."""
    dq = multiply(np.asarray(q_from, dtype=np.float64) * [-1.0, -1.0, -1.0, 1.0], q_to)
    return np.where(dq[..., 3:] >= 0, dq, -dq)


def right_jacobian(rotation_vector: ArrayLike) -> FloatArray:
    """J_r(phi) of Exp(phi + d) = Exp(phi) Exp(J_r d) + O(d^2); (..., 3) -> (..., 3, 3).

    The two coefficients are even functions of the angle; below 1e-4 rad their series is exact to rounding.
    """
    x, y, z = _numbers(rotation_vector)
    square = x * x + y * y + z * z
    first: Any
    second: Any
    if not isinstance(square, float):
        small = square < 1e-8
        safe = np.where(small, 1.0, square)
        angles = np.sqrt(safe)
        first = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(angles)) / safe)
        second = np.where(small, 1.0 / 6.0 - square / 120.0, (angles - np.sin(angles)) / (safe * angles))
    elif square < 1e-8:
        first, second = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        angle = math.sqrt(square)
        first, second = (1.0 - math.cos(angle)) / square, (angle - math.sin(angle)) / (square * angle)
    # I - first [phi]x + second [phi]x^2, with [phi]x^2 = phi phi^T - |phi|^2 I
    on_axis = 1.0 - second * square
    xy, xz, yz = second * x * y, second * x * z, second * y * z
    return _array(
        [
            [on_axis + second * x * x, xy + first * z, xz - first * y],
            [xy - first * z, on_axis + second * y * y, yz + first * x],
            [xz + first * y, yz - first * x, on_axis + second * z * z],
        ]
    )


def turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R v of each vector, R one for all or one for each; (3, 3) or (M, 3, 3), (M, 3) -> (M, 3)."""
    product: FloatArray = (R @ vectors[..., None])[..., 0] if R.ndim > 2 else vectors @ R.T
    return product


def _numbers(array: ArrayLike) -> list[Any]:
    """The components, as arrays of many rotations or as Python floats of a single one.

    A single rotation is a dozen products, which NumPy would take ten times as long for.
    """
    components = np.asarray(array, dtype=np.float64)
    return components.tolist() if components.ndim == 1 else list(np.moveaxis(components, -1, 0))


def _array(components: Any) -> FloatArray:
    """What `_numbers` took apart, nested as the last axes."""
    nested = np.array(components)
    depth = 2 if isinstance(components[0], list) else 1
    return nested if nested.ndim == depth else np.ascontiguousarray(np.moveaxis(nested, range(depth), range(-depth, 0)))
