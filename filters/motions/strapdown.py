"""Strapdown integration of the samples of an inertial unit, with its biases and gravity as variables.

Derivation: docs/derivations/inertial.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.inputs import InertialSamples
from filters.contract.outputs import Variable
from filters.contract.validation import finite_array, positive
from filters.geometry.vectors import cross, plus, product, quaternion, rotate, scaled, turned_by
from filters.motions.motion_model import MotionModel


@dataclass(frozen=True)
class Strapdown(MotionModel):
    """Strapdown integration of inertial samples, with biases and gravity as variables. Needs samples in every step.

    Noise and place of the unit are those that the samples state. Variables: "imu-bias", of the gyros and of the
    accelerometers; "gravity", in W; and with `sigma_mounting` "imu-mounting", a rotation vector in the camera frame.

    Parameters
    ----------
    gravity : (3,) sequence of float
        In W, m/s^2: 9.81 along y where the camera was level at the start.
    sigma_gravity : float
        Standard deviation of each component of that, m/s^2.
    sigma_gyro_bias, sigma_accelerometer_bias : float
        Of the biases at the start, rad/s and m/s^2, each axis.
    sigma_mounting : float
        Of the error of the stated orientation of the unit, rad, each axis; 0: it is exact.
    """

    gravity: tuple[float, float, float] = (0.0, 9.81, 0.0)
    sigma_gravity: float = 0.5
    sigma_gyro_bias: float = 0.01
    sigma_accelerometer_bias: float = 0.1
    sigma_mounting: float = 0.0
    takes: ClassVar[type[InertialSamples]] = InertialSamples
    driven: ClassVar[bool] = True

    def __post_init__(self) -> None:
        gravity = finite_array("gravity", self.gravity, (3,))
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        names = "sigma_gravity", "sigma_gyro_bias", "sigma_accelerometer_bias", "sigma_mounting"
        g, gyro, accelerometer, mounting = (positive(name, getattr(self, name), allow_zero=True) for name in names)
        biases = Variable("imu-bias", np.zeros(6), np.diag(np.repeat([gyro, accelerometer], 3) ** 2))
        variables = [biases, Variable("gravity", gravity, g**2 * np.eye(3), in_world=True)]
        if mounting:
            variables.append(Variable("imu-mounting", np.zeros(3), mounting**2 * np.eye(3)))
        object.__setattr__(self, "variables", tuple(variables))

    def step(self, x: Any, dt: float, n: Any) -> Any:
        """One sample: rate and specific force are constant in the frame of the unit, half-way through the turn."""
        angular_rate, specific_force, gyro_walk, accelerometer_walk, lever, mounted = n
        r, q, v, w_before, bias, gravity = x[:6]
        angles = (*x[6:], (0.0, 0.0, 0.0))[0]  # "imu-mounting", where it is a variable
        in_camera = product(quaternion(angles), mounted)
        w = rotate(in_camera, plus(angular_rate, bias[:3], -1.0))
        f = rotate(in_camera, plus(specific_force, bias[3:], -1.0))
        r_unit, v_unit = plus(r, rotate(q, lever), 1.0), plus(v, rotate(q, cross(w_before, lever)), 1.0)
        a = plus(rotate(q, turned_by(scaled(0.5 * dt, w), f)), gravity, 1.0)
        r_unit, v_unit = plus(plus(r_unit, v_unit, dt), a, 0.5 * dt * dt), plus(v_unit, a, dt)
        q = product(q, quaternion(scaled(dt, w)))
        r, v = plus(r_unit, rotate(q, lever), -1.0), plus(v_unit, rotate(q, cross(w, lever)), -1.0)
        bias = plus(bias[:3], gyro_walk, 1.0) + plus(bias[3:], accelerometer_walk, 1.0)
        return (r, q, v, w, bias, gravity, *x[6:])
