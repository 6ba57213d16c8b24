"""Motion by odometry: dead reckoning, and odometry as a measurement of the pose after a step relative to that before.

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.inputs import BodyVelocity
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
from filters.geometry.rotations import matrix_of, product_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import cross_matrix, multiply, put, times, transposed
from filters.motions.motion_model import (
    ANGULAR,
    CAMERA_SIZE,
    LINEAR,
    POSITION,
    ROTATION,
    CameraState,
    MotionKernels,
    MotionModel,
    MotionPrediction,
)


def _step(
    settings: FloatArray,
    state: FloatArray,
    dt: float,
    odometry: FloatArray,
    moved: FloatArray,
    F: FloatArray,
    Q: FloatArray,
) -> None:
    v0, v1, v2 = odometry[0, 0], odometry[0, 1], odometry[0, 2]
    w0, w1, w2 = odometry[0, 3], odometry[0, 4], odometry[0, 5]
    h0, h1, h2, h3 = quaternion_of(0.5 * dt * w0, 0.5 * dt * w1, 0.5 * dt * w2)
    half, R = matrix_of(h0, h1, h2, h3), matrix_of(state[3], state[4], state[5], state[6])
    middle = multiply(R, half)
    a0, a1, a2 = times(half, v0, v1, v2)
    by_rotation = multiply(R, cross_matrix(a0, a1, a2))
    by_turn = multiply(
        multiply(middle, cross_matrix(v0, v1, v2)), right_jacobian_of(0.5 * dt * w0, 0.5 * dt * w1, 0.5 * dt * w2)
    )
    t0, t1, t2, t3 = quaternion_of(dt * w0, dt * w1, dt * w2)
    q0, q1, q2, q3 = product_of(state[3], state[4], state[5], state[6], t0, t1, t2, t3)
    velocity = times(middle, v0, v1, v2)
    for i in range(13, len(state)):
        moved[i] = state[i]
    for i in range(CAMERA_SIZE, len(F)):
        F[i, i] = 1.0
    moved[3], moved[4], moved[5], moved[6] = q0, q1, q2, q3
    put(F, 3, 3, transposed(matrix_of(t0, t1, t2, t3)), 1.0)
    put(F, 0, 3, by_rotation, -dt)
    put(F, 6, 3, by_rotation, -1.0)
    G = np.zeros((CAMERA_SIZE, 6))
    put(G, 0, 0, middle, dt)
    put(G, 0, 3, by_turn, -0.5 * dt * dt)
    put(G, 3, 3, right_jacobian_of(dt * w0, dt * w1, dt * w2), dt)
    put(G, 6, 0, middle, 1.0)
    put(G, 6, 3, by_turn, -0.5 * dt)
    for i in range(3):
        F[i, i], G[9 + i, 3 + i] = 1.0, 1.0
        moved[i], moved[7 + i], moved[10 + i] = state[i] + velocity[i] * dt, velocity[i], odometry[0, 3 + i]
    for i in range(CAMERA_SIZE):
        for k in range(6):
            along = 0.0
            for m in range(6):
                along += G[i, m] * odometry[1 + m, k]
            for j in range(CAMERA_SIZE):
                Q[i, j] += along * G[j, k]


@dataclass(frozen=True)
class VelocityDriven(MotionModel):
    """Dead reckoning: the odometry is the motion, its covariance the only noise. Needs odometry in every step."""

    kernels: ClassVar[MotionKernels | None] = MotionKernels(_step)

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


def moved_by(odometry: BodyVelocity, dt: float, moved: Pose) -> tuple[FloatArray, FloatArray]:
    """Innovation (6,) of the relative pose `moved`, and its covariance (6, 6).

    The mean velocity is that of the camera half-way through the turn, so that in the frame before the step it has moved
    by Exp(dt w / 2) v dt, and turned by Exp(dt w). Errors are those of `relative_jacobian`: position, m, in the frame
    before the step, and rotation, rad, on the right.
    """
    turn, way = odometry.angular * dt, odometry.linear * dt
    half = rotations.exp(0.5 * turn)
    J = np.zeros((6, 6))
    J[:3, :3] = dt * half
    J[:3, 3:] = -0.5 * dt * half @ rotations.skew(way) @ rotations.right_jacobian(0.5 * turn)
    J[3:, 3:] = dt * rotations.right_jacobian(turn)
    turned = rotations.log(moved.R_wc.T @ rotations.exp(turn))
    return np.concatenate([half @ way - moved.position, turned]), J @ odometry.covariance @ J.T
