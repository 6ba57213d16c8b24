"""SO(3): quaternions (xyzw), rotation vectors and their Jacobians.

A perturbation always acts on the right, in the camera frame: R(q) Exp(delta), where R_wc = R(q). A filter turns a
single camera some ten times a frame, so for one rotation the closed forms are written out here, in plain numbers
(functions named `..._of`), which kernels call, too. Where one of many is NaN, so is its result alone.

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]


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
    if np.ndim(quaternion) == 1:
        return np.array(matrix_of(*_numbers(quaternion))).reshape(3, 3)
    q = np.asarray(quaternion, dtype=np.float64)
    return np.stack(matrix_of(*np.moveaxis(q, -1, 0)), axis=-1).reshape(*q.shape[:-1], 3, 3)


def exp(rotation_vector: ArrayLike) -> FloatArray:
    """Rotation matrix Exp(phi); (..., 3) rad -> (..., 3, 3)."""
    return matrix(exp_quaternion(rotation_vector))


def log(rotation_matrix: ArrayLike) -> FloatArray:
    """Rotation vector Log(R), of length in [0, pi]; (..., 3, 3) -> (..., 3) rad."""
    R = np.asarray(rotation_matrix, dtype=np.float64)
    if _is_one_rotation(R):
        return np.array(vector_of(*from_matrix_of(*_numbers(R.ravel()))))
    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()).reshape(*R.shape[:-2], 3)


def from_matrix(rotation_matrix: ArrayLike) -> FloatArray:
    """The unit quaternion xyzw of a rotation matrix; (..., 3, 3) -> (..., 4)."""
    R = np.asarray(rotation_matrix, dtype=np.float64)
    if _is_one_rotation(R):
        return np.array(from_matrix_of(*_numbers(R.ravel())))
    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat()).reshape(*R.shape[:-2], 4)


def exp_quaternion(rotation_vector: ArrayLike) -> FloatArray:
    """The quaternion q(phi) of Eq. 6; (..., 3) rad -> (..., 4) xyzw."""
    if np.ndim(rotation_vector) > 1:
        phi = np.array(rotation_vector, dtype=np.float64)  # a copy: SciPy 1.17 refuses read-only arrays
        # One leading dimension: what scipy takes on every Python.
        return np.asarray(Rotation.from_rotvec(phi.reshape(-1, 3)).as_quat()).reshape(*phi.shape[:-1], 4)
    return np.array(quaternion_of(*_numbers(rotation_vector)))


def multiply(left: ArrayLike, right: ArrayLike) -> FloatArray:
    """Quaternion product left x right, normalised; (..., 4), (..., 4) xyzw -> (..., 4)."""
    if np.ndim(left) == np.ndim(right) == 1:
        return np.array(product_of(*_numbers(left), *_numbers(right)))
    p, q = np.asarray(left, dtype=np.float64), np.asarray(right, dtype=np.float64)
    vector = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + np.cross(p[..., :3], q[..., :3])
    scalar = p[..., 3:] * q[..., 3:] - np.sum(p[..., :3] * q[..., :3], axis=-1, keepdims=True)
    product = np.concatenate([vector, scalar], axis=-1)
    normalised: FloatArray = product / np.linalg.norm(product, axis=-1, keepdims=True)
    return normalised


def between(q_from: ArrayLike, q_to: ArrayLike) -> FloatArray:
    """The quaternion dq with q_to = q_from x dq, scalar part >= 0; (..., 4), (..., 4) -> (..., 4)."""
    dq = multiply(np.asarray(q_from, dtype=np.float64) * [-1.0, -1.0, -1.0, 1.0], q_to)
    return np.where(dq[..., 3:] >= 0, dq, -dq)


def right_jacobian(rotation_vector: ArrayLike) -> FloatArray:
    """J_r(phi) of Exp(phi + d) = Exp(phi) Exp(J_r d) + O(d^2); (..., 3) -> (..., 3, 3)."""
    if np.ndim(rotation_vector) == 1:
        return np.array(right_jacobian_of(*_numbers(rotation_vector))).reshape(3, 3)
    phi = np.asarray(rotation_vector, dtype=np.float64)
    square = np.einsum("...i,...i->...", phi, phi)[..., None, None]
    small = square < 1e-8
    safe = np.where(small, 1.0, square)
    angle = np.sqrt(safe)
    first = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(angle)) / safe)
    second = np.where(small, 1.0 / 6.0 - square / 120.0, (angle - np.sin(angle)) / (safe * angle))
    across = skew(phi)
    jacobian: FloatArray = np.eye(3) - first * across + second * across @ across
    return jacobian


def turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R v of each vector, R one for all or one for each; (3, 3) or (M, 3, 3), (M, 3) -> (M, 3)."""
    product: FloatArray = (R @ vectors[..., None])[..., 0] if R.ndim > 2 else vectors @ R.T
    return product


def _numbers(array: ArrayLike) -> list[float]:
    """Python floats: single rotations are a dozen products, which NumPy would take ten times as long for."""
    numbers: list[float] = np.asarray(array, dtype=np.float64).tolist()
    return numbers


def _is_one_rotation(R: FloatArray) -> bool:
    """Whether this is a single matrix, and a rotation up to rounding; scipy mends others, or refuses them."""
    if R.shape != (3, 3):
        return False
    a, b, c, d, e, f, g, h, i = R.ravel().tolist()
    rows = (a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0)
    between_rows = (a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i)
    right_handed = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
    return right_handed and all(-1e-12 < product < 1e-12 for product in rows + between_rows)  # False for NaN


@compiled
def matrix_of(x: float, y: float, z: float, w: float) -> Nine:
    """`matrix`, row by row."""
    return (
        *(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        *(2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        *(2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


@compiled
def quaternion_of(x: float, y: float, z: float) -> Four:
    """Unit quaternion of a rotation vector, as `exp_quaternion`, in plain numbers."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    # sin(half) / angle; its series below 1e-4 rad is exact to rounding.
    ratio = 0.5 * math.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
    return ratio * x, ratio * y, ratio * z, math.cos(half)


@compiled
def from_matrix_of(a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, i: float) -> Four:
    """`from_matrix`, from the numbers row by row.

    Four times the largest component of the quaternion times each of them (Markley, J. Guidance 31(2), 2008).
    """
    trace = a + e + i
    largest = max(a, e, i, trace)
    if a == largest:
        x, y, z, w = 1.0 - trace + 2.0 * a, d + b, g + c, h - f
    elif e == largest:
        x, y, z, w = b + d, 1.0 - trace + 2.0 * e, h + f, c - g
    elif i == largest:
        x, y, z, w = c + g, f + h, 1.0 - trace + 2.0 * i, d - b
    else:
        x, y, z, w = h - f, c - g, d - b, 1.0 + trace
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return x / norm, y / norm, z / norm, w / norm


@compiled
def vector_of(x: float, y: float, z: float, w: float) -> Three:
    """The rotation vector of a unit quaternion, of length in [0, pi]."""
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, abs(w))
    if angle <= 1e-3:  # the series is exact to rounding
        square = angle * angle
        ratio = 2.0 + square / 12.0 + 7.0 * square * square / 2880.0
    else:
        ratio = angle / math.sin(0.5 * angle)
    if w < 0.0:
        ratio = -ratio
    return ratio * x, ratio * y, ratio * z


@compiled
def product_of(x: float, y: float, z: float, w: float, a: float, b: float, c: float, d: float) -> Four:
    """Normalised product of two quaternions, as `multiply`, in plain numbers."""
    i = w * a + x * d + y * c - z * b
    j = w * b - x * c + y * d + z * a
    k = w * c + x * b - y * a + z * d
    r = w * d - x * a - y * b - z * c
    scale = 1.0 / math.sqrt(i * i + j * j + k * k + r * r)
    return i * scale, j * scale, k * scale, r * scale


@compiled
def right_jacobian_of(x: float, y: float, z: float) -> Nine:
    """`right_jacobian`, row by row.

    The two coefficients are even functions of the angle; below 1e-4 rad their series is exact to rounding.
    """
    square = x * x + y * y + z * z
    if square < 1e-8:
        first, second = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        angle = math.sqrt(square)
        first, second = (1.0 - math.cos(angle)) / square, (angle - math.sin(angle)) / (square * angle)
    # I - first [phi]x + second [phi]x^2, with [phi]x^2 = phi phi^T - |phi|^2 I
    on_axis = 1.0 - second * square
    xy, xz, yz = second * x * y, second * x * z, second * y * z
    return (
        *(on_axis + second * x * x, xy + first * z, xz - first * y),
        *(xy - first * z, on_axis + second * y * y, yz + first * x),
        *(xz + first * y, yz - first * x, on_axis + second * z * z),
    )


@compiled
def left_jacobian_derivative_of(t0: float, t1: float, t2: float, a0: float, a1: float, a2: float) -> Nine:
    """d (J_l(theta) a) / d theta, row by row.

    J_l(theta) a = a + b (theta x a) + c theta x (theta x a), b = (1 - cos) / angle^2, c = (angle - sin) / angle^3.
    """
    square = t0 * t0 + t1 * t1 + t2 * t2
    angle = math.sqrt(square)
    if angle < 1e-1:
        b = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
        c = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))
        # derivatives of b and c by t, over t
        db = -1.0 / 12.0 + square / 180.0 * (1.0 - square * 3.0 / 112.0)
        dc = -1.0 / 60.0 + square / 1260.0 * (1.0 - square / 48.0)
    else:
        sine, cosine = math.sin(angle), math.cos(angle)
        b, c = (1.0 - cosine) / square, (angle - sine) / (square * angle)
        db = (angle * sine - 2.0 * (1.0 - cosine)) / (square * square)
        dc = ((1.0 - cosine) * angle - 3.0 * (angle - sine)) / (square * square * angle)
    x0, x1, x2 = t1 * a2 - t2 * a1, t2 * a0 - t0 * a2, t0 * a1 - t1 * a0
    dot = t0 * a0 + t1 * a1 + t2 * a2
    y0, y1, y2 = t0 * dot - square * a0, t1 * dot - square * a1, t2 * dot - square * a2
    u0, u1, u2 = db * x0 + dc * y0, db * x1 + dc * y1, db * x2 + dc * y2
    return (
        u0 * t0 + c * (dot + t0 * a0 - 2.0 * a0 * t0),
        u0 * t1 + b * a2 + c * (t0 * a1 - 2.0 * a0 * t1),
        u0 * t2 - b * a1 + c * (t0 * a2 - 2.0 * a0 * t2),
        u1 * t0 - b * a2 + c * (t1 * a0 - 2.0 * a1 * t0),
        u1 * t1 + c * (dot + t1 * a1 - 2.0 * a1 * t1),
        u1 * t2 + b * a0 + c * (t1 * a2 - 2.0 * a1 * t2),
        u2 * t0 + b * a1 + c * (t2 * a0 - 2.0 * a2 * t0),
        u2 * t1 - b * a0 + c * (t2 * a1 - 2.0 * a2 * t1),
        u2 * t2 + c * (dot + t2 * a2 - 2.0 * a2 * t2),
    )
