"""Inputs of a filter: stereo measurements, odometry, inertial samples with their unit, and the start state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.noise import LARGEST_VARIANCE, StereoNoise
from filters.contract.validation import at_most, covariance_matrix, finite_array, positive, unique_ids, unit_quaternion
from filters.geometry.arrays import BoolArray, FloatArray, IntArray

FASTEST, LARGEST_SPEED_VARIANCE = 1e6, 1e12
"""Numbers up to which filters are tested: m/s or rad/s, and their squares."""


@dataclass(frozen=True, eq=False)
class StereoObservation:
    """Measurements of the stereo camera in one frame.

    Parameters
    ----------
    ids : (M,) array_like of int
        Landmark identities, unique.
    uvd : (M, 3) array_like
        Left pixel and disparity, px. d <= 0 is legal: noise on a far point.
    v_right : (M,) array_like, optional
        Row measured in the right image, px, where the sensor measures it on its own.
    R : (M, 3, 3) array_like, optional
        Covariance of each measurement, px^2; where None, the filter's `noise` holds. One whose last variance is 1e18
        has no disparity: `of_left` makes such ones.
    bodies : (M,) array_like of int, optional
        Where it is known: the moving body that each landmark is on, -1 for the scene, -2 for unknown. Only filters with
        moving bodies ask for it.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, repeated ids, an R that is not symmetric positive definite or above 1e18 px^2.
    """

    ids: IntArray
    uvd: FloatArray
    v_right: FloatArray | None = None
    R: FloatArray | None = None
    bodies: IntArray | None = None

    def __post_init__(self) -> None:
        ids = unique_ids("ids", self.ids)
        uvd = finite_array("uvd", self.uvd, ("M", 3))
        if len(uvd) != len(ids):
            raise ValueError(f"uvd must have one row per id: {len(ids)} ids, {len(uvd)} rows")
        object.__setattr__(self, "ids", ids)
        object.__setattr__(self, "uvd", uvd)
        if self.v_right is not None:
            v_right = finite_array("v_right", self.v_right, ("M",))
            if len(v_right) != len(ids):
                raise ValueError(f"v_right must have one entry per id: {len(ids)} ids, {len(v_right)} entries")
            object.__setattr__(self, "v_right", v_right)
        if self.bodies is not None:
            bodies = np.asarray(self.bodies)
            if bodies.shape != ids.shape or not np.issubdtype(bodies.dtype, np.integer) or (bodies < -2).any():
                raise ValueError(f"bodies must be {len(ids)} integers >= -2, one per id, got {self.bodies!r}")
            object.__setattr__(self, "bodies", bodies.astype(np.int64))
        if self.R is not None:
            R = np.zeros((0, 3, 3)) if len(ids) == 0 else self.R
            object.__setattr__(self, "R", covariance_matrix("R", R, 3, batch=len(ids), definite=True))
            at_most("R", self.R, LARGEST_VARIANCE, "px^2")

    @classmethod
    def of_left(cls, ids: ArrayLike, uv: ArrayLike, R: ArrayLike) -> StereoObservation:
        """Measurements of one camera alone: pixels uv (M, 2) with covariance R, (2, 2) or (M, 2, 2), no disparity."""
        uv = finite_array("uv", uv, ("M", 2))
        every = np.zeros((len(uv), 3, 3))
        every[:, :2, :2], every[:, 2, 2] = R, LARGEST_VARIANCE
        return cls(np.asarray(ids), np.column_stack([uv, np.zeros(len(uv))]), R=every)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def with_disparity(self) -> BoolArray:
        """(M,): which measurements have a disparity, however bad."""
        return np.ones(len(self), dtype=np.bool_) if self.R is None else self.R[:, 2, 2] < LARGEST_VARIANCE

    @property
    def has_disparity(self) -> bool:
        """Whether all measurements have one."""
        return bool(self.with_disparity.all())

    def select(self, index: ArrayLike) -> StereoObservation:
        """The measurements at `index` (positions or a mask), in that order."""
        i = np.asarray(index)
        # Every measurement has been checked when this observation was made; only positions can repeat one.
        part = object.__new__(StereoObservation)
        fields = {name: None if value is None else value[i] for name, value in vars(self).items()}
        vars(part).update(fields)
        if i.dtype != np.bool_:
            unique_ids("ids", part.ids)
        return part

    def covariances(self, noise: StereoNoise) -> FloatArray:
        """R of each measurement: its own, or that of `noise`; (M, 3, 3) px^2."""
        return noise.R[None].repeat(len(self), axis=0) if self.R is None else self.R

    def ordered(self) -> StereoObservation:
        """The measurements in ascending order of ids."""
        return self if (self.ids[1:] > self.ids[:-1]).all() else self.select(np.argsort(self.ids))


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
        """Numbers (3, 7) that kernels take: place and densities; orientation; walks; zeros behind."""
        rows = np.zeros((3, 7))
        rows[0, :5] = *self.position, self.gyro_density, self.accelerometer_density
        rows[1, :4], rows[2, :2] = self.orientation, (self.gyro_walk, self.accelerometer_walk)
        return rows


@dataclass(frozen=True, eq=False)
class InertialSamples:
    """Measurements of an inertial unit over the step that ends now.

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

    @property
    def rows(self) -> FloatArray:
        """Numbers (3 + K, 7) that kernels take: rows of the unit; then time, rates and forces of each sample."""
        return np.vstack([self.unit.rows, np.column_stack([self.times, self.angular_rates, self.specific_forces])])

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


# Standard deviations where no covariance is given: a known pose (m, rad), a broad velocity (m/s, rad/s).
KNOWN_POSE = 1e-6
BROAD_LINEAR_VELOCITY = 10.0
BROAD_ANGULAR_VELOCITY = 0.5


@dataclass(frozen=True, eq=False)
class Start:
    """State that a filter is told at `reset`, and how well it is known.

    Parameters
    ----------
    position : (3,) array_like
        r^WC, m.
    orientation : (4,) array_like
        q^WC, unit quaternion xyzw.
    linear_velocity : (3,) array_like
        m/s, in W.
    angular_velocity : (3,) array_like
        rad/s, camera frame.
    covariance : (12, 12) array_like, optional
        Of position (W), rotation (camera frame, rad), linear velocity (W), angular velocity (camera).
        None: a known pose (standard deviation 1e-6) and a broad velocity, see `assumed_covariance`.

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, a quaternion that is not a unit one, a covariance that is not symmetric positive
        semi-definite: the message names the argument.
    """

    position: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]  # an array after __post_init__
    orientation: FloatArray = (0.0, 0.0, 0.0, 1.0)  # type: ignore[assignment]
    linear_velocity: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    angular_velocity: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("position", "linear_velocity", "angular_velocity"):
            object.__setattr__(self, name, finite_array(name, getattr(self, name), (3,)))
        orientation = unit_quaternion("orientation", self.orientation)
        orientation.flags.writeable = False
        object.__setattr__(self, "orientation", orientation)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", covariance_matrix("covariance", self.covariance, 12))

    @property
    def assumed_covariance(self) -> FloatArray:
        """`covariance`, or the one assumed where none is given; (12, 12), read-only."""
        return _UNKNOWN_VELOCITY if self.covariance is None else self.covariance


_UNKNOWN_VELOCITY = np.diag(np.repeat([KNOWN_POSE, KNOWN_POSE, BROAD_LINEAR_VELOCITY, BROAD_ANGULAR_VELOCITY], 3) ** 2)
_UNKNOWN_VELOCITY.flags.writeable = False


@dataclass(frozen=True, eq=False)
class BodyVelocity:
    """Odometry: the mean velocity of the left camera over the step that ends now.

    Parameters
    ----------
    linear : (3,) array_like
        m/s, camera frame.
    angular : (3,) array_like
        rad/s, camera frame.
    covariance : (6, 6) array_like
        Of (linear, angular).

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, a covariance that is not symmetric positive semi-definite; more than 1e6 m/s or
        rad/s, or a variance above 1e12.
    """

    linear: FloatArray
    angular: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "linear", finite_array("odometry.linear", self.linear, (3,)))
        object.__setattr__(self, "angular", finite_array("odometry.angular", self.angular, (3,)))
        covariance = covariance_matrix("odometry.covariance", self.covariance, 6)
        at_most("odometry.linear", self.linear, FASTEST, "m/s")
        at_most("odometry.angular", self.angular, FASTEST, "rad/s")
        at_most("odometry.covariance", covariance, LARGEST_SPEED_VARIANCE, "m^2/s^2 or rad^2/s^2")
        object.__setattr__(self, "covariance", covariance)

    @property
    def rows(self) -> FloatArray:
        """Numbers (7, 6) that kernels take: the velocities; their covariance."""
        return np.vstack([np.concatenate([self.linear, self.angular]), self.covariance])
