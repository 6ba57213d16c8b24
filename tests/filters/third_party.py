"""Parts as a third party would write them: the fewest functions there may be, numerical Jacobians, own variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import MeasurementModel, MotionModel, Variable
from filters.geometry import rotations
from filters.geometry.poses import RotationVector
from filters.geometry.vectors import plus, product, quaternion, rotate, scaled

DISPARITY_ERRORS = Variable("disparity-errors", [1.02, 0.003], np.diag([0.01, 0.002]) ** 2)
"""Scale of the disparity, and its shear over v."""


@dataclass(frozen=True)
class ShearedPair(MeasurementModel):
    """A rectified pair whose disparity has an unknown scale and shear: d' = s d + t (v - cy)."""

    variables: tuple[Variable, ...] = (DISPARITY_ERRORS,)

    def project(self, camera, h, values):
        """(u, v, d')."""
        (scale, shear), v = values.disparity_errors, camera.fy * h[1] / h[2] + camera.cy
        d = camera.fx * camera.baseline * h[3] / h[2]
        return camera.fx * h[0] / h[2] + camera.cx, v, scale * d + shear * (v - camera.cy)

    def unproject(self, camera, uvd, values):
        """The inverse."""
        scale, shear = values.disparity_errors
        d = (uvd[2] - shear * (uvd[1] - camera.cy)) / scale
        x, y = (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy
        return x, y, 1.0, d / (camera.fx * camera.baseline)


BIAS = Variable("bias", [0.1, 0.0, -0.05, 0.01, 0.0, 0.02], 0.05**2 * np.eye(6), random_walk=np.full(6, 0.01))
"""Of odometry, m/s and rad/s."""
MOUNTING = Variable(
    "mounting", rotations.exp_quaternion([0.02, -0.01, 0.03]), 0.01**2 * np.eye(3), retraction=RotationVector()
)
"""Rotation of the odometer in the camera frame."""


@dataclass(frozen=True)
class BiasedOdometry(MotionModel):
    """Dead reckoning by an odometer that is biased and mounted askew."""

    variables: tuple[Variable, ...] = (BIAS, MOUNTING)

    driven = True

    def step(self, x, dt, n):
        """The measured velocity less bias, turned into the camera frame."""
        bias, mounting = x.bias, x.mounting
        linear = rotate(mounting, plus(n[0], bias[:3], -1.0))
        angular = rotate(mounting, plus(n[1], bias[3:], -1.0))
        velocity = rotate(x.orientation, linear)
        orientation = product(x.orientation, quaternion(scaled(dt, angular)))
        return plus(x.position, velocity, dt), orientation, velocity, angular, bias, mounting
