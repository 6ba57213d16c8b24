"""Constant velocity with white accelerations (Eq. 6, 11, 12), and motion by odometry.

Odometry is dead reckoning, or a measurement of the pose after a step relative to that before. F and G are derived from
`step` by dual numbers; docs/derivations/motion.md has them in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.inputs import BodyVelocity
from filters.contract.validation import positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
from filters.geometry.vectors import inverse, plus, product, quaternion, rotate, scaled, turned_by
from filters.motions.motion_model import MotionModel


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

    def __post_init__(self) -> None:
        positive("sigma_acceleration", self.sigma_acceleration, allow_zero=True)
        positive("sigma_angular_acceleration", self.sigma_angular_acceleration, allow_zero=True)

    def sigmas(self, dt: float) -> tuple[float, ...]:
        """Standard deviations of the impulses V and Omega."""
        linear, angular = self.sigma_acceleration * dt, self.sigma_angular_acceleration * dt
        return linear, linear, linear, angular, angular, angular

    def step(self, x: Any, dt: float, n: Any) -> Any:
        """Eq. 6: the impulses act on the velocities before the step."""
        v, w = plus(x.linear_velocity, n[:3], 1.0), plus(x.angular_velocity, n[3:], 1.0)
        return plus(x.position, v, dt), product(x.orientation, quaternion(scaled(dt, w))), v, w

    def odometry(self, x: Any, dt: float) -> Any:
        """Linear velocity in the camera frame half-way through the turn, and angular velocity."""
        v_c = rotate(inverse(x.orientation), x.linear_velocity)
        return turned_by(scaled(0.5 * dt, x.angular_velocity), v_c), x.angular_velocity


@dataclass(frozen=True)
class VelocityDriven(MotionModel):
    """Dead reckoning: the odometry is the motion, its covariance the only noise. Needs odometry in every step."""

    driven: ClassVar[bool] = True

    def step(self, x: Any, dt: float, n: Any) -> Any:
        """r' = r + R Exp(w dt / 2) v dt, q' = q x q(w dt) with n = (v, w)."""
        v, w = n
        v_w = rotate(x.orientation, turned_by(scaled(0.5 * dt, w), v))
        return plus(x.position, v_w, dt), product(x.orientation, quaternion(scaled(dt, w))), v_w, w


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
