"""Odometry of a step as a measurement of the pose after it relative to the pose before it."""

from __future__ import annotations

import numpy as np

from filters.contract.odometry import BodyVelocity
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose


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
