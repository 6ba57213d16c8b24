"""Dead reckoning: the odometry is the motion.

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
    MotionModel,
    MotionPrediction,
)


@dataclass(frozen=True)
class VelocityDriven(MotionModel):
    """Dead reckoning: the odometry is the motion, its covariance the only noise. Needs odometry in every step."""

    kernel: ClassVar[str | None] = "velocity-driven"

    def check_odometry(self, odometry: BodyVelocity | None) -> None:
        """It needs some."""
        if odometry is None:
            raise ValueError(
                "odometry must be given in every predict with motion=VelocityDriven(): "
                "pass a BodyVelocity, or use motion=ConstantVelocity(...)"
            )

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """R' = r + R Exp(w dt / 2) v dt, q' = q x q(w dt); noise n = errors of (v, w)."""
        self.check_odometry(odometry)
        assert odometry is not None
        turn = odometry.angular * dt
        half = rotations.exp(0.5 * turn)
        R_mid = state.R_wc @ half
        moved = CameraState(
            state.position + R_mid @ odometry.linear * dt,
            rotations.multiply(state.orientation, rotations.exp_quaternion(turn)),
            R_mid @ odometry.linear,
            odometry.angular,
            state.variables,
        )
        by_rotation = -state.R_wc @ rotations.skew(half @ odometry.linear)
        by_turn = -0.5 * dt * R_mid @ rotations.skew(odometry.linear) @ rotations.right_jacobian(0.5 * turn)
        F = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
        F[POSITION, POSITION] = np.eye(3)
        F[POSITION, ROTATION] = by_rotation * dt
        F[ROTATION, ROTATION] = rotations.exp(-turn)
        F[LINEAR, ROTATION] = by_rotation
        G = np.zeros((CAMERA_SIZE, 6))
        G[POSITION, :3], G[POSITION, 3:] = R_mid * dt, by_turn * dt
        G[ROTATION, 3:] = rotations.right_jacobian(turn) * dt
        G[LINEAR, :3], G[LINEAR, 3:] = R_mid, by_turn
        G[ANGULAR, 3:] = np.eye(3)
        return MotionPrediction(moved, F, G, odometry.covariance)
