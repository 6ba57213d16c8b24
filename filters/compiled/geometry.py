"""Kernels of rotations, landmarks and the rectified pair: `rotations`, `landmarks`, `measurements` for one of each.

Small arrays are written in place; loops are written out, because Numba compiles them in a fraction of the time that
assignments of slices take.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from filters import rotations
from filters.validation import FloatArray

ENTRY: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True, "cache": True}
"""IEEE arithmetic with fused multiply-add; kept on disk; other threads may run."""
OPTIONS: dict[str, Any] = {**ENTRY, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""The same for functions that only kernels call: without the wrappers, they compile in half of the time."""

_matrix_of, _quaternion_of = njit(**OPTIONS)(rotations.matrix_of), njit(**OPTIONS)(rotations.quaternion_of)
_product_of, _right_jacobian_of = njit(**OPTIONS)(rotations.product_of), njit(**OPTIONS)(rotations.right_jacobian_of)

POSITION, ORIENTATION, LINEAR, ANGULAR, CALIBRATION, PREDICTED = 0, 3, 7, 10, 13, 19
"""Where the values of a filter begin: pose, velocity and calibration, and the same as predicted last."""
VALUES, CALIBRATIONS = 38, 6
FX, FY, CX, CY, FB, TAIL_DOF, MIN_DISPARITY, SIGMA_LINEAR, SIGMA_ANGULAR = range(9)
"""Numbers of a recipe."""


@njit(**OPTIONS)
def fill(target: FloatArray, nine: tuple[float, ...], scale: float) -> None:
    """target (3, 3) = scale times nine numbers, row by row."""
    for i, number in enumerate(nine):
        target[i // 3, i % 3] = scale * number


@njit(**OPTIONS)
def copy(source: FloatArray, target: FloatArray) -> None:
    """target (k,) = source: a loop compiles in a fraction of the time that an assignment of slices takes."""
    for i in range(len(target)):
        target[i] = source[i]


@njit(**OPTIONS)
def copy_matrix(source: FloatArray, target: FloatArray) -> None:
    """target (k, l) = source."""
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[i, j] = source[i, j]


@njit(**OPTIONS)
def rotation(quaternion: FloatArray, R: FloatArray) -> None:
    """R (3, 3) of a quaternion."""
    fill(R, _matrix_of(quaternion[0], quaternion[1], quaternion[2], quaternion[3]), 1.0)


@njit(**OPTIONS)
def exponential(phi: FloatArray, R: FloatArray) -> None:
    """R (3, 3) = Exp(phi)."""
    x, y, z, w = _quaternion_of(phi[0], phi[1], phi[2])
    fill(R, _matrix_of(x, y, z, w), 1.0)


@njit(**OPTIONS)
def right_jacobian(phi: FloatArray, sign: float, J: FloatArray) -> None:
    """J (3, 3) = J_r(sign phi): with sign -1 the left Jacobian of phi."""
    fill(J, _right_jacobian_of(sign * phi[0], sign * phi[1], sign * phi[2]), 1.0)


@njit(**OPTIONS)
def turn_quaternion(q: FloatArray, phi: FloatArray, additive: bool, out: FloatArray) -> None:
    """out = q x q(phi), or q x (phi / 2, 1) normalised."""
    if additive:
        moved = _product_of(q[0], q[1], q[2], q[3], 0.5 * phi[0], 0.5 * phi[1], 0.5 * phi[2], 1.0)
    else:
        x, y, z, w = _quaternion_of(phi[0], phi[1], phi[2])
        moved = _product_of(q[0], q[1], q[2], q[3], x, y, z, w)
    for i in range(4):
        out[i] = moved[i]


@njit(**OPTIONS)
def multiply(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """out (3, 3) = A B."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit(**OPTIONS)
def inverse(A: FloatArray, out: FloatArray) -> None:
    """out (3, 3) = A^-1."""
    out[0, 0] = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    out[1, 0] = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    out[2, 0] = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    scale = 1.0 / (A[0, 0] * out[0, 0] + A[0, 1] * out[1, 0] + A[0, 2] * out[2, 0])
    out[0, 1] = A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2]
    out[1, 1] = A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]
    out[2, 1] = A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]
    out[0, 2] = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    out[1, 2] = A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2]
    out[2, 2] = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] *= scale


@njit(**OPTIONS)
def skew(a: FloatArray, sign: float, out: FloatArray) -> None:
    """out (3, 3) = sign [a]x."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 2] = -sign * a[2], sign * a[1], -sign * a[0]
    out[1, 0], out[2, 0], out[2, 1] = sign * a[2], -sign * a[1], sign * a[0]


@njit(**OPTIONS)
def left_jacobian_derivative(theta: FloatArray, a: FloatArray, out: FloatArray) -> None:
    """`rotations.left_jacobian_derivative`: out (3, 3) = d (J_l(theta) a) / d theta."""
    square = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    if square < 1e-6:
        b, c = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
        b_slope, c_slope = -1.0 / 12.0 + square / 180.0, -1.0 / 60.0 + square / 1260.0
    else:
        angle = math.sqrt(square)
        b, c = (1.0 - math.cos(angle)) / square, (angle - math.sin(angle)) / (square * angle)
        b_slope = (angle * math.sin(angle) - 2.0 * (1.0 - math.cos(angle))) / square**2
        c_slope = ((1.0 - math.cos(angle)) * angle - 3.0 * (angle - math.sin(angle))) / (square**2 * angle)
    x0 = theta[1] * a[2] - theta[2] * a[1]
    x1 = theta[2] * a[0] - theta[0] * a[2]
    x2 = theta[0] * a[1] - theta[1] * a[0]
    across = (x0, x1, x2)
    twice = (theta[1] * x2 - theta[2] * x1, theta[2] * x0 - theta[0] * x2, theta[0] * x1 - theta[1] * x0)
    skew(a, -b, out)
    along = c * (theta[0] * a[0] + theta[1] * a[1] + theta[2] * a[2])
    for i in range(3):
        for j in range(3):
            out[i, j] += (b_slope * across[i] + c_slope * twice[i]) * theta[j]
            out[i, j] += c * (theta[i] * a[j] - 2.0 * a[i] * theta[j])
        out[i, i] += along


@njit(**OPTIONS)
def ray(theta: float, phi: float, out: FloatArray) -> None:
    """`inverse_depth.ray_direction` and its Jacobian by theta and phi, one after the other in `out` (9,)."""
    sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    out[0], out[1], out[2] = cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta
    out[3], out[4], out[5] = cos_phi * cos_theta, 0.0, -cos_phi * sin_theta
    out[6], out[7], out[8] = -sin_phi * sin_theta, -cos_phi, -sin_phi * cos_theta


@njit(**OPTIONS)
def angles_jacobian(x: float, y: float, z: float, out: FloatArray) -> None:
    """`inverse_depth.angles_jacobian` of a direction, in out (2, 3)."""
    across_squared = x * x + z * z
    across, length_squared = math.sqrt(across_squared), across_squared + y * y
    out[0, 0], out[0, 1], out[0, 2] = z / across_squared, 0.0, -x / across_squared
    out[1, 0] = x * y / (length_squared * across)
    out[1, 1] = -across / length_squared
    out[1, 2] = z * y / (length_squared * across)


@njit(**OPTIONS)
def seen_from(
    position: FloatArray, blocks: FloatArray, anchor: int, own: int, rays: FloatArray, seen: FloatArray
) -> None:
    """`LandmarkModel.homogeneous` of one landmark, and its anchor relative to the camera, in `seen` (7,)."""
    if anchor < 0:  # Euclidean
        for i in range(3):
            seen[i] = blocks[own, i] - position[i]
        seen[3] = 1.0
        return
    rho = blocks[own, 2]
    ray(blocks[own, 0], blocks[own, 1], rays)
    for i in range(3):
        seen[4 + i] = blocks[anchor, i] - position[i]
        seen[i] = rho * seen[4 + i] + rays[i]
    seen[3] = rho


@njit(**OPTIONS)
def project(numbers: FloatArray, calibration: FloatArray, h: FloatArray, rho: float, uvd: FloatArray) -> None:
    """(u, v, d) of a homogeneous point h (3,), rho, by the calibrated pair; h is turned in place."""
    inverse_z = 1.0 / h[2]
    focal = 1.0 + calibration[1]
    uvd[0] = focal * (numbers[FX] * h[0] * inverse_z) + numbers[CX]
    uvd[1] = focal * (numbers[FY] * h[1] * inverse_z) + numbers[CY]
    uvd[2] = focal * (1.0 + calibration[2]) * (numbers[FB] * rho * inverse_z) + calibration[0]


@njit(**OPTIONS)
def misaligned(calibration: FloatArray) -> bool:
    """Whether camera and body are turned against each other."""
    return calibration[3] != 0.0 or calibration[4] != 0.0 or calibration[5] != 0.0


@njit(**OPTIONS)
def turned(R: FloatArray, h: FloatArray, out: FloatArray) -> None:
    """out = R h."""
    for i in range(3):
        out[i] = R[i, 0] * h[0] + R[i, 1] * h[1] + R[i, 2] * h[2]


@njit(**OPTIONS)
def project_jacobian(
    numbers: FloatArray, calibration: FloatArray, h: FloatArray, rho: float, uvd: FloatArray, J: FloatArray
) -> None:
    """Jacobian of (u, v, d) in J (3, 10): by h in the camera (3), by rho, by the six numbers of the calibration."""
    inverse_z, focal, scale = 1.0 / h[2], 1.0 + calibration[1], 1.0 + calibration[2]
    for a in range(3):
        for c in range(10):
            J[a, c] = 0.0
    fx, fy, fb = focal * numbers[FX], focal * numbers[FY], focal * scale * numbers[FB]
    J[0, 0], J[0, 2] = fx * inverse_z, -fx * h[0] * inverse_z**2
    J[1, 1], J[1, 2] = fy * inverse_z, -fy * h[1] * inverse_z**2
    J[2, 2], J[2, 3] = -fb * rho * inverse_z**2, fb * inverse_z
    J[2, 4] = 1.0
    J[0, 5], J[1, 5] = numbers[FX] * h[0] * inverse_z, numbers[FY] * h[1] * inverse_z
    J[2, 5] = scale * numbers[FB] * rho * inverse_z
    J[2, 6] = focal * numbers[FB] * rho * inverse_z
    # d(Exp(X) h)/dX = -[Exp(X) h]x J_l(X): J_l follows where X is not zero
    for a in range(3):
        g0, g1, g2 = J[a, 0], J[a, 1], J[a, 2]
        J[a, 7], J[a, 8], J[a, 9] = h[1] * g2 - h[2] * g1, h[2] * g0 - h[0] * g2, h[0] * g1 - h[1] * g0
