"""Kernels of the motion models: constant velocity, and driven by odometry (`filters.motions`)."""

from __future__ import annotations

import numpy as np
from numba import njit

from filters.compiled.covariance import transform_leading
from filters.compiled.geometry import (
    ANGULAR,
    LINEAR,
    OPTIONS,
    ORIENTATION,
    POSITION,
    PREDICTED,
    SIGMA_ANGULAR,
    SIGMA_LINEAR,
    exponential,
    multiply,
    right_jacobian,
    rotation,
    skew,
    turn_quaternion,
)
from filters.compiled.retraction import FIRST_ESTIMATES
from filters.validation import FloatArray

CONSTANT_VELOCITY, VELOCITY_DRIVEN = range(2)


@njit(**OPTIONS)
def _world_rotation(values: FloatArray, start: int, velocity: int, out: FloatArray) -> None:
    """`world_rotation_of_variables` of the pose and velocity that begin at `start`; out (lead, 3)."""
    out[:] = 0.0
    R = np.empty((3, 3))
    skew(values[start + POSITION :], -1.0, out[0:3])
    rotation(values[start + ORIENTATION :], R)
    for i in range(3):
        for j in range(3):
            out[3 + i, j] = R[j, i]
    skew(values[start + LINEAR :], -1.0, out[velocity : velocity + 3])


@njit(**OPTIONS)
def predict(
    P: FloatArray,
    n: int,
    values: FloatArray,
    motion: int,
    error: int,
    lead: int,
    velocity: int,
    numbers: FloatArray,
    walk_rates: FloatArray,
    dt: float,
    odometry: FloatArray,
    covariance: FloatArray,
) -> None:
    """`StereoEKF.predict` without what odometry adds to constant velocity; values and P in place."""
    F, added = np.zeros((lead, lead)), np.zeros((lead, lead))
    for i in range(lead):
        F[i, i] = 1.0
        added[i, i] = walk_rates[i] * dt
    turn, half, R, R_mid, A, B = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3)), *_two()
    linear, angular = velocity, velocity + 3
    if motion == CONSTANT_VELOCITY:
        for i in range(3):
            turn[i] = values[ANGULAR + i] * dt
            F[i, linear + i] = dt
        exponential(turn, R)
        right_jacobian(turn, 1.0, A)
        for i in range(3):
            for j in range(3):
                F[3 + i, 3 + j] = R[j, i]
                F[3 + i, angular + j] = A[i, j] * dt
        # G Q G^T: the impulses act on the velocities before the step
        q_linear, q_angular = (numbers[SIGMA_LINEAR] * dt) ** 2, (numbers[SIGMA_ANGULAR] * dt) ** 2
        for i in range(3):
            added[linear + i, linear + i] += q_linear
            added[angular + i, angular + i] += q_angular
            added[i, i] += dt * dt * q_linear
            added[i, linear + i] += dt * q_linear
            added[linear + i, i] += dt * q_linear
            for j in range(3):
                added[3 + i, angular + j] += F[3 + i, angular + j] * q_angular
                added[angular + j, 3 + i] += F[3 + i, angular + j] * q_angular
                for k in range(3):
                    added[3 + i, 3 + j] += F[3 + i, angular + k] * q_angular * F[3 + j, angular + k]
            values[POSITION + i] += values[LINEAR + i] * dt
    else:
        for i in range(3):
            turn[i], half[i] = odometry[3 + i] * dt, 0.5 * odometry[3 + i] * dt
            F[linear + i, linear + i] = F[angular + i, angular + i] = 0.0
        rotation(values[ORIENTATION:], R)
        exponential(half, A)
        multiply(R, A, R_mid)
        # by rotation: -R [Exp(turn / 2) v]x
        h, v = np.empty(3), np.empty(3)
        for i in range(3):
            h[i] = A[i, 0] * odometry[0] + A[i, 1] * odometry[1] + A[i, 2] * odometry[2]
            v[i] = R_mid[i, 0] * odometry[0] + R_mid[i, 1] * odometry[1] + R_mid[i, 2] * odometry[2]
        skew(h, -1.0, B)
        by_rotation = np.empty((3, 3))
        multiply(R, B, by_rotation)
        # by turn: -dt / 2 R_mid [v]x J_r(turn / 2)
        skew(odometry[0:3], -0.5 * dt, B)
        multiply(R_mid, B, A)
        right_jacobian(half, 1.0, B)
        by_turn = np.empty((3, 3))
        multiply(A, B, by_turn)
        exponential(turn, A)
        right_jacobian(turn, 1.0, B)
        G = np.zeros((lead, 6))
        for i in range(3):
            for j in range(3):
                F[i, 3 + j] = by_rotation[i, j] * dt
                F[3 + i, 3 + j] = A[j, i]
                F[linear + i, 3 + j] = by_rotation[i, j]
                G[i, j], G[i, 3 + j] = R_mid[i, j] * dt, by_turn[i, j] * dt
                G[3 + i, 3 + j] = B[i, j] * dt
                G[linear + i, j], G[linear + i, 3 + j] = R_mid[i, j], by_turn[i, j]
            G[angular + i, 3 + i] = 1.0
        GQ = np.zeros((lead, 6))
        for i in range(lead):
            for k in range(6):
                if G[i, k] != 0.0:
                    for j in range(6):
                        GQ[i, j] += G[i, k] * covariance[k, j]
        for i in range(lead):
            for j in range(lead):
                for k in range(6):
                    added[i, j] += GQ[i, k] * G[j, k]
        for i in range(3):
            values[POSITION + i] += v[i] * dt
            values[LINEAR + i] = v[i]
            values[ANGULAR + i] = odometry[3 + i]
    q = np.empty(4)
    turn_quaternion(values[ORIENTATION:], turn, False, q)
    for i in range(4):
        values[ORIENTATION + i] = q[i]
    if error == FIRST_ESTIMATES:
        source, image, defect = np.empty((lead, 3)), np.empty((lead, 3)), np.empty((lead, 3))
        _world_rotation(values, PREDICTED, velocity, source)
        _world_rotation(values, 0, velocity, image)
        rotation(values[PREDICTED + ORIENTATION :], R)
        for i in range(lead):
            for j in range(3):
                defect[i, j] = image[i, j]
                for k in range(lead):
                    defect[i, j] -= F[i, k] * source[k, j]
        for i in range(lead):
            for j in range(3):
                F[i, 3 + j] += defect[i, 0] * R[0, j] + defect[i, 1] * R[1, j] + defect[i, 2] * R[2, j]
    for i in range(PREDICTED):
        values[PREDICTED + i] = values[i]
    transform_leading(P, F, added, n)


@njit(**OPTIONS)
def _two() -> tuple[FloatArray, FloatArray]:
    return np.empty((3, 3)), np.empty((3, 3))


@njit(**OPTIONS)
def measure_odometry(
    values: FloatArray, velocity: int, dt: float, odometry: FloatArray, innovation: FloatArray, H: FloatArray
) -> None:
    """`ConstantVelocity.odometry_measurement`: innovation (1, 6), H (1, 6, lead)."""
    half, back_half, R, J, A = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), *_two()
    for i in range(3):
        half[i] = 0.5 * dt * values[ANGULAR + i]
    exponential(half, back_half)
    rotation(values[ORIENTATION:], R)
    v = np.empty(3)
    for i in range(3):
        v[i] = R[0, i] * values[LINEAR] + R[1, i] * values[LINEAR + 1] + R[2, i] * values[LINEAR + 2]
    skew(v, 1.0, A)
    by_half_turn = np.empty((3, 3))
    multiply(back_half, A, by_half_turn)
    right_jacobian(half, 1.0, A)
    multiply(by_half_turn, A, J)
    H[:] = 0.0
    for i in range(3):
        innovation[0, i] = odometry[i]
        for j in range(3):
            innovation[0, i] -= back_half[i, j] * v[j]
            H[0, i, 3 + j] = by_half_turn[i, j]
            H[0, i, velocity + 3 + j] = -0.5 * dt * J[i, j]
            for k in range(3):
                H[0, i, velocity + j] += back_half[i, k] * R[j, k]
        innovation[0, 3 + i] = odometry[3 + i] - values[ANGULAR + i]
        H[0, 3 + i, velocity + 3 + i] = 1.0
