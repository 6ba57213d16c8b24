"""Constant velocity with white accelerations (Eq. 6, 11, 12).

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.inputs import BodyVelocity
from filters.contract.validation import positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.rotations import matrix_of, product_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import cross_matrix, multiply, put, times, transposed
from filters.motions.motion_model import (
    ANGULAR,
    CAMERA_SIZE,
    LINEAR,
    POSITION,
    ROTATION,
    CameraState,
    LinearMeasurement,
    MotionKernels,
    MotionModel,
    MotionPrediction,
)

_EYE = np.eye(CAMERA_SIZE)


def _step(
    settings: FloatArray,
    state: FloatArray,
    dt: float,
    odometry: FloatArray,
    moved: FloatArray,
    F: FloatArray,
    Q: FloatArray,
) -> None:
    w0, w1, w2 = dt * state[10], dt * state[11], dt * state[12]
    h0, h1, h2, h3 = quaternion_of(w0, w1, w2)
    q0, q1, q2, q3 = product_of(state[3], state[4], state[5], state[6], h0, h1, h2, h3)
    for i in range(len(state)):
        moved[i] = state[i]
    moved[3], moved[4], moved[5], moved[6] = q0, q1, q2, q3
    for i in range(len(F)):
        F[i, i] = 1.0
    put(F, 3, 3, transposed(matrix_of(h0, h1, h2, h3)), 1.0)
    put(F, 3, 9, right_jacobian_of(w0, w1, w2), dt)
    for i in range(3):
        moved[i] = state[i] + dt * state[7 + i]
        F[i, 6 + i] = dt
    linear, angular = (settings[0] * dt) ** 2, (settings[1] * dt) ** 2
    for k in range(6, CAMERA_SIZE):  # the impulses act on the velocities before the step
        variance = linear if k < 9 else angular
        for i in range(CAMERA_SIZE):
            along = F[i, k] * variance
            if along != 0.0:
                for j in range(CAMERA_SIZE):
                    Q[i, j] += along * F[j, k]


def _measure(
    settings: FloatArray,
    moved: FloatArray,
    dt: float,
    odometry: FloatArray,
    innovation: FloatArray,
    H: FloatArray,
    R: FloatArray,
) -> None:
    w0, w1, w2 = 0.5 * dt * moved[10], 0.5 * dt * moved[11], 0.5 * dt * moved[12]
    h0, h1, h2, h3 = quaternion_of(w0, w1, w2)
    back = matrix_of(h0, h1, h2, h3)
    R_cw = transposed(matrix_of(moved[3], moved[4], moved[5], moved[6]))
    c0, c1, c2 = times(R_cw, moved[7], moved[8], moved[9])
    by_half_turn = multiply(back, cross_matrix(c0, c1, c2))
    put(H, 0, 3, by_half_turn, 1.0)
    put(H, 0, 6, multiply(back, R_cw), 1.0)
    put(H, 0, 9, multiply(by_half_turn, right_jacobian_of(w0, w1, w2)), -0.5 * dt)
    expected = times(back, c0, c1, c2)
    for i in range(3):
        H[3 + i, 9 + i] = 1.0
        innovation[i] = odometry[0, i] - expected[i]
        innovation[3 + i] = odometry[0, 3 + i] - moved[10 + i]
    for i in range(6):
        for j in range(6):
            R[i, j] = odometry[1 + i, j]


@dataclass(frozen=True)
class ConstantVelocity(MotionModel):
    """Constant velocity with white accelerations (Eq. 6): impulses V = a dt and Omega = alpha dt each step.

    Odometry, where given, is a measurement of the velocity of the step and is fused after the prediction.

    Parameters
    ----------
    sigma_acceleration : float
        Standard deviation of each component of a, m/s^2.
    sigma_angular_acceleration : float
        Standard deviation of each component of alpha, rad/s^2.
    """

    sigma_acceleration: float = 3.0
    sigma_angular_acceleration: float = 0.6
    kernels: ClassVar[MotionKernels | None] = MotionKernels(
        _step, _measure, 6, settings=("sigma_acceleration", "sigma_angular_acceleration")
    )

    def __post_init__(self) -> None:
        positive("sigma_acceleration", self.sigma_acceleration, allow_zero=True)
        positive("sigma_angular_acceleration", self.sigma_angular_acceleration, allow_zero=True)

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """Eq. 6 at zero noise, with F and G of Eq. 12; noise n = (V, Omega)."""
        turn = state.angular_velocity * dt
        by_quaternion = rotations.exp_quaternion(turn)
        moved = CameraState(
            state.position + state.linear_velocity * dt,
            rotations.multiply(state.orientation, by_quaternion),
            state.linear_velocity,
            state.angular_velocity,
            state.variables,
        )
        F = np.empty((*turn.shape[:-1], CAMERA_SIZE, CAMERA_SIZE))
        F[...] = _EYE
        F[..., POSITION, LINEAR] = dt * _EYE[:3, :3]
        F[..., ROTATION, ROTATION] = rotations.matrix(by_quaternion).swapaxes(-1, -2)
        F[..., ROTATION, ANGULAR] = rotations.right_jacobian(turn) * dt
        G = F[..., LINEAR.start :]  # the impulses act on the velocities before the step
        Q = np.zeros((6, 6))
        Q.flat[:15:7], Q.flat[21::7] = (self.sigma_acceleration * dt) ** 2, (self.sigma_angular_acceleration * dt) ** 2
        return MotionPrediction(moved, F, G, Q)

    def odometry_measurement(self, state: CameraState, dt: float, odometry: BodyVelocity) -> LinearMeasurement | None:
        """Measure the velocity of the step: linear in the camera frame half-way through the turn, and angular."""
        half_turn = 0.5 * dt * state.angular_velocity
        back_half = rotations.exp(half_turn)
        R_cw = state.R_wc.swapaxes(-1, -2)
        v_c = rotations.turned(R_cw, state.linear_velocity)
        by_half_turn = back_half @ rotations.skew(v_c)
        H = np.zeros((*v_c.shape[:-1], 6, CAMERA_SIZE))
        H[..., :3, ROTATION] = by_half_turn
        H[..., :3, LINEAR] = back_half @ R_cw
        H[..., :3, ANGULAR] = -0.5 * dt * by_half_turn @ rotations.right_jacobian(half_turn)
        H[..., 3:, ANGULAR] = _EYE[:3, :3]
        linear, angular = odometry.linear - rotations.turned(back_half, v_c), odometry.angular - state.angular_velocity
        return LinearMeasurement(np.concatenate([linear, angular], axis=-1), H, odometry.covariance)
