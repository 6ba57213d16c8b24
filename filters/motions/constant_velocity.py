"""Constant velocity with white accelerations (Eq. 6, 11, 12).

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.odometry import BodyVelocity
from filters.geometry import rotations
from filters.motions.model import (
    ANGULAR,
    CAMERA_SIZE,
    LINEAR,
    POSITION,
    ROTATION,
    CameraState,
    LinearMeasurement,
    MotionModel,
    MotionPrediction,
)
from filters.validation import positive

_EYE = np.eye(CAMERA_SIZE)


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
    kernel: ClassVar[str | None] = "constant-velocity"

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
