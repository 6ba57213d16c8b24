"""Vectors as tuples of numbers, of columns or of dual numbers, and 3x3 matrices as nine numbers, row by row."""

from __future__ import annotations

from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import Nine, Three


@compiled
def cross(a: Any, b: Any) -> Any:
    """Cross product a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _series(theta: Any, v: Any, b: Any, c: Any) -> Any:
    """v + b [theta]x v + c [theta]x^2 v."""
    first = cross(theta, v)
    second = cross(theta, first)
    return (
        v[0] + b * first[0] + c * second[0],
        v[1] + b * first[1] + c * second[1],
        v[2] + b * first[2] + c * second[2],
    )


@compiled
def turned_by(theta: Any, v: Any) -> Any:
    """Exp(theta) v (Rodrigues); smooth at zero, so that derivatives are."""
    angle = np.sqrt(theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2])
    half = np.sinc(angle * (0.5 / np.pi))
    b, c = np.sinc(angle * (1.0 / np.pi)), 0.5 * half * half
    return _series(theta, v, b, c)


@compiled
def spread_by(theta: Any, v: Any) -> Any:
    """J_l(theta) v, the left Jacobian of a rotation vector; theta is one for all."""
    square = theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2]
    half = np.sinc(np.sqrt(square) * (0.5 / np.pi))
    b = 0.5 * half * half
    if square < 1e-2:
        c = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))
    else:
        c = (1.0 - np.sinc(np.sqrt(square) * (1.0 / np.pi))) / square
    return _series(theta, v, b, c)


@compiled
def plus(a: Any, b: Any, scale: Any) -> Any:
    """a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@compiled
def scaled(scale: Any, v: Any) -> Any:
    """Product of a number and a vector."""
    return scale * v[0], scale * v[1], scale * v[2]


@compiled
def quaternion(theta: Any) -> Any:
    """Unit quaternion xyzw of a rotation vector; smooth at zero, so that derivatives are."""
    half = 0.5 * np.sqrt(theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2])
    ratio = 0.5 * np.sinc(half * (1.0 / np.pi))
    return ratio * theta[0], ratio * theta[1], ratio * theta[2], np.cos(half)


@compiled
def product(p: Any, q: Any) -> Any:
    """Product of two quaternions xyzw, normalised: the rotation by q, then by p."""
    x = p[3] * q[0] + q[3] * p[0] + p[1] * q[2] - p[2] * q[1]
    y = p[3] * q[1] + q[3] * p[1] + p[2] * q[0] - p[0] * q[2]
    z = p[3] * q[2] + q[3] * p[2] + p[0] * q[1] - p[1] * q[0]
    w = p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2]
    over = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
    return x * over, y * over, z * over, w * over


@compiled
def rotate(q: Any, v: Any) -> Any:
    """R(q) v of a unit quaternion xyzw."""
    across = cross(q, v)
    twice = cross(q, across)
    return (
        v[0] + 2.0 * (q[3] * across[0] + twice[0]),
        v[1] + 2.0 * (q[3] * across[1] + twice[1]),
        v[2] + 2.0 * (q[3] * across[2] + twice[2]),
    )


@compiled
def inverse(q: Any) -> Any:
    """Unit quaternion xyzw of the rotation back."""
    return -q[0], -q[1], -q[2], q[3]


IDENTITY: Nine = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@compiled
def multiply(a: Nine, b: Nine) -> Nine:
    """Product of two matrices."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@compiled
def transposed(a: Nine) -> Nine:
    """Transpose of a matrix."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@compiled
def times(a: Nine, x: float, y: float, z: float) -> Three:
    """Product with a vector."""
    return a[0] * x + a[1] * y + a[2] * z, a[3] * x + a[4] * y + a[5] * z, a[6] * x + a[7] * y + a[8] * z


@compiled
def cross_matrix(x: float, y: float, z: float) -> Nine:
    """[a]x, so that [a]x b = a x b."""
    return 0.0, -z, y, z, 0.0, -x, -y, x, 0.0


@compiled
def put(target: FloatArray, row: int, column: int, nine: Nine, scale: float) -> None:
    """target[row:, column:] (3, 3) = scale times a matrix."""
    for i, number in enumerate(nine):
        target[row + i // 3, column + i % 3] = scale * number
