"""Parts as a third party would write them: the fewest functions there may be, numerical Jacobians, own variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import MeasurementModel, MotionModel, StereoCamera, Variable
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.retractions import RotationVector
from filters.geometry.vectors import plus, product, quaternion, rotate, scaled
from filters.measurements.measurement_model import Values

DISPARITY_ERRORS = Variable("disparity-errors", [1.02, 0.003], np.diag([0.01, 0.002]) ** 2)
"""Scale of the disparity, and its shear over v."""


@dataclass(frozen=True)
class ShearedPair(MeasurementModel):
    """A rectified pair whose disparity has an unknown scale and shear: d' = s d + t (v - cy)."""

    variables: tuple[Variable, ...] = (DISPARITY_ERRORS,)

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """(u, v, d')."""
        scale, shear = values["disparity-errors"]
        uvd = camera.project_scaled(points_c[..., :3], points_c[..., 3])
        uvd[..., 2] = scale * uvd[..., 2] + shear * (uvd[..., 1] - camera.cy)
        return uvd

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The inverse."""
        scale, shear = values["disparity-errors"]
        d = (uvd[:, 2] - shear * (uvd[:, 1] - camera.cy)) / scale
        return np.column_stack([camera.ray(uvd), d / camera.disparity_constant])


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
