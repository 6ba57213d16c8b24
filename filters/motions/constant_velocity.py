"""Constant velocity with white accelerations (Eq. 6, 11, 12).

F and G are derived from `step` by dual numbers; docs/derivations/motion.md has them in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from filters.contract.validation import positive
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
