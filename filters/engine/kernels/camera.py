"""Kernels of `motion`, `engine.retraction` and `engine.symmetric`: camera state and its part of P."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from filters import rotations
from filters.engine.kernels.signatures import COVARIANCE, FIXED, FLOATS, MATRIX, VECTOR
from filters.engine.retraction import additive_transport_of
from filters.motion import ANGULAR, CAMERA_SIZE, ROTATION
from filters.validation import FloatArray

_matrix_of, _quaternion_of = njit(**FLOATS)(rotations.matrix_of), njit(**FLOATS)(rotations.quaternion_of)
_product_of, _right_jacobian_of = njit(**FLOATS)(rotations.product_of), njit(**FLOATS)(rotations.right_jacobian_of)
_additive_transport_of = njit(**FLOATS)(additive_transport_of)


@njit(**FLOATS)
def _fill(target: FloatArray, nine: tuple[float, ...], scale: float) -> None:
    """target (3, 3) = scale times nine numbers, row by row."""
    for i, number in enumerate(nine):
        target[i // 3, i % 3] = scale * number


@njit(types.void(COVARIANCE, MATRIX, MATRIX), **FIXED)
def transform_leading(P: FloatArray, F: FloatArray, added: FloatArray) -> None:
    """`symmetric.transform_leading`."""
    n, camera = len(P), len(F)
    old, half = np.empty((camera, camera)), np.zeros((camera, camera))
    for i in range(camera):
        for j in range(i + 1):
            old[i, j] = old[j, i] = P[i, j]
    for i in range(camera):
        for k in range(camera):
            if F[i, k] != 0.0:
                for j in range(camera):
                    half[i, j] += F[i, k] * old[k, j]
    for i in range(camera):
        for j in range(i + 1):
            P[i, j] = 0.5 * (added[i, j] + added[j, i])
            for k in range(camera):
                P[i, j] += half[i, k] * F[j, k]
    cross = np.empty((camera, n - camera))
    for k in range(camera):
        for j in range(n - camera):
            cross[k, j] = P[camera + j, k]
    for i in range(camera):
        changed = False
        for k in range(camera):
            changed = changed or F[i, k] != (1.0 if i == k else 0.0)
        if changed:
            for j in range(n - camera):
                P[camera + j, i] = 0.0
            for k in range(camera):
                if F[i, k] != 0.0:
                    for j in range(n - camera):
                        P[camera + j, i] += F[i, k] * cross[k, j]


@njit(
    types.float64[::1](COVARIANCE, VECTOR, VECTOR, VECTOR, VECTOR, types.float64, types.float64, types.float64),
    **FIXED,
)
def predict(
    P: FloatArray,
    position: FloatArray,
    orientation: FloatArray,
    linear: FloatArray,
    angular: FloatArray,
    dt: float,
    linear_variance: float,
    angular_variance: float,
) -> FloatArray:
    """`ConstantVelocity.predict` and what follows of it for P; the new position and orientation, (7,)."""
    turn = _quaternion_of(angular[0] * dt, angular[1] * dt, angular[2] * dt)
    moved = _product_of(orientation[0], orientation[1], orientation[2], orientation[3], *turn)
    F, pose = np.eye(CAMERA_SIZE), np.empty(7)
    _fill(F[ROTATION, ROTATION].T, _matrix_of(*turn), 1.0)
    _fill(F[ROTATION, ANGULAR], _right_jacobian_of(angular[0] * dt, angular[1] * dt, angular[2] * dt), dt)
    for i in range(3):
        F[i, 6 + i] = dt
        pose[i] = position[i] + dt * linear[i]
        P[6 + i, 6 + i] += linear_variance
        P[9 + i, 9 + i] += angular_variance
    transform_leading(P, F, np.zeros((CAMERA_SIZE, CAMERA_SIZE)))
    for i in range(4):
        pose[3 + i] = moved[i]
    return pose


@njit(
    types.Tuple((types.float64[::1], types.float64[:, ::1]))(
        COVARIANCE, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX, VECTOR, types.boolean
    ),
    **FIXED,
)
def retract(
    P: FloatArray,
    position: FloatArray,
    orientation: FloatArray,
    linear: FloatArray,
    angular: FloatArray,
    blocks: FloatArray,
    delta: FloatArray,
    additive: bool,
) -> tuple[FloatArray, FloatArray]:
    """`StandardError.moved` and `transport`: the new camera (position, orientation, velocities) and blocks."""
    x, y, z = delta[3], delta[4], delta[5]
    M = np.eye(CAMERA_SIZE)
    if additive:
        turn = (0.5 * x, 0.5 * y, 0.5 * z, 1.0)
        _fill(M[ROTATION, ROTATION], _additive_transport_of(x, y, z), 1.0)
    else:
        turn = _quaternion_of(x, y, z)
        _fill(M[ROTATION, ROTATION], _right_jacobian_of(x, y, z), 1.0)
    transform_leading(P, M, np.zeros((CAMERA_SIZE, CAMERA_SIZE)))
    turned = _product_of(orientation[0], orientation[1], orientation[2], orientation[3], *turn)
    camera, moved = np.empty(13), np.empty_like(blocks)
    for i in range(3):
        camera[i] = position[i] + delta[i]
        camera[7 + i] = linear[i] + delta[6 + i]
        camera[10 + i] = angular[i] + delta[9 + i]
    for i in range(4):
        camera[3 + i] = turned[i]
    for b in range(len(blocks)):
        for i in range(3):
            moved[b, i] = blocks[b, i] + delta[CAMERA_SIZE + 3 * b + i]
    return camera, moved
