"""Inertial samples, as filters take them, and the unit that they are of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filters.contract.odometry import FASTEST
from filters.contract.validation import at_most, finite_array, positive, unit_quaternion
from filters.geometry.arrays import FloatArray

_CLOCK = 1e-6
"""Rounding of differences of time stamps, s."""


@dataclass(frozen=True, eq=False)
class InertialUnit:
    """Inertial measurement unit: its place on the rig, and its noise as a data sheet has it.

    Parameters
    ----------
    position : (3,) array_like
        Of the accelerometers, in the camera frame, m.
    orientation : (4,) array_like
        Unit quaternion xyzw that takes vectors of the unit to the camera frame.
    gyro_density, accelerometer_density : float
        White noise, rad/s and m/s^2 per root of a hertz.
    gyro_walk, accelerometer_walk : float
        Random walks of the biases, rad/s and m/s^2 per root of a second.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, a quaternion that is not a unit one, a negative noise.
    """

    position: FloatArray
    orientation: FloatArray
    gyro_density: float
    accelerometer_density: float
    gyro_walk: float
    accelerometer_walk: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", finite_array("unit.position", self.position, (3,)))
        object.__setattr__(self, "orientation", unit_quaternion("unit.orientation", self.orientation))
        for name in ("gyro_density", "accelerometer_density", "gyro_walk", "accelerometer_walk"):
            object.__setattr__(self, name, positive(f"unit.{name}", getattr(self, name), allow_zero=True))

    @cached_property
    def rows(self) -> FloatArray:
        """As kernels take it, (3, 7): place and densities; orientation; walks; zeros behind."""
        rows = np.zeros((3, 7))
        rows[0, :5] = *self.position, self.gyro_density, self.accelerometer_density
        rows[1, :4], rows[2, :2] = self.orientation, (self.gyro_walk, self.accelerometer_walk)
        return rows


@dataclass(frozen=True, eq=False)
class InertialSamples:
    """What an inertial unit measured over the step that ends now.

    A sample is the mean over the interval from the sample before, or from the beginning of the step, to its time. The
    last one also stands for what is left of the step.

    Parameters
    ----------
    times : (K,) array_like
        Ends of the intervals, ascending, s since the beginning of the step.
    angular_rates : (K, 3) array_like
        rad/s, in the frame of the unit.
    specific_forces : (K, 3) array_like
        Acceleration less gravity, m/s^2, in the frame of the unit.
    unit : InertialUnit
        Where it sits, and its noise.

    Raises
    ------
    ValueError
        Wrong shapes, no sample, NaN or infinity, times that do not ascend from above 0; more than 1e6 rad/s or m/s^2.
    """

    times: FloatArray
    angular_rates: FloatArray
    specific_forces: FloatArray
    unit: InertialUnit

    def __post_init__(self) -> None:
        times = finite_array("inertial.times", self.times, ("K",))
        if len(times) == 0 or (np.diff(times, prepend=0.0) <= 0.0).any():
            raise ValueError("inertial.times must ascend from above 0, one at least: count them from the last frame")
        object.__setattr__(self, "times", times)
        for name, unit in (("angular_rates", "rad/s"), ("specific_forces", "m/s^2")):
            values = finite_array(f"inertial.{name}", getattr(self, name), (len(times), 3))
            at_most(f"inertial.{name}", values, FASTEST, unit)
            object.__setattr__(self, name, values)
        if not isinstance(self.unit, InertialUnit):
            raise ValueError(f"inertial.unit must be an InertialUnit, got {self.unit!r}")

    def check_step(self, dt: float) -> None:
        """Raise a `ValueError` if the samples are not those of a step of `dt` seconds."""
        last, K = float(self.times[-1]), len(self.times)
        if not -_CLOCK <= dt - last <= 1.5 * last / K + _CLOCK or (K > 1 and self.times[-2] >= dt):
            raise ValueError(
                f"inertial.times must end with the step, at {dt:.6g} s, got {self.times[-1]:.6g} s: give the samples "
                "since the last frame, with times counted from there"
            )

    def followed_by(self, later: InertialSamples, dt: float) -> InertialSamples:
        """These samples, of a step of `dt` seconds, and those of the step after it, as samples of one step."""
        times = np.concatenate([self.times[:-1], [dt], dt + later.times])
        rates, forces = (
            np.concatenate([getattr(self, name), getattr(later, name)]) for name in ("angular_rates", "specific_forces")
        )
        return InertialSamples(times, rates, forces, self.unit)
