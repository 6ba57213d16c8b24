"""The car, how a scripted drive sways, and the pan-tilt head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.world.routes import FRAME_PERIOD


@dataclass(frozen=True)
class Car:
    """Limits and size of the car, in m, s and rad; steering is that of the front wheels.

    Tyres that slide bear no more than `max_lateral_acceleration`: a faster car turns less than it is steered.
    `camera_forward` is from the rear axle to the left camera, `size` length, width and height of the body, and `body_c`
    its centre in the left camera frame.
    """

    wheelbase: float = 2.7
    camera_forward: float = 1.6
    max_speed: float = 12.0
    max_acceleration: float = 3.0
    max_steering: float = 0.55
    max_steering_rate: float = 1.0
    max_lateral_acceleration: float = 6.0
    size: tuple[float, float, float] = (4.2, 1.8, 1.1)
    body_c: tuple[float, float, float] = (0.0, 0.8, -0.25)


class Sway:
    """Small, bounded perturbations of a scripted drive; scale 0 drives the nominal route exactly.

    The velocity of each step is the nominal one, plus an Ornstein-Uhlenbeck process on the three linear and the three
    angular components, minus a pull back to the nominal pose that keeps height, roll, pitch and the lane.
    """

    _SIGMAS = np.array([0.08, 0.08, 0.15, 0.012, 0.008, 0.012])
    _TIME_CONSTANTS = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    PULL = 0.5
    """Rate at which a deviation decays, 1/s."""

    def __init__(self, scale: float) -> None:
        sigmas, decay = scale * self._SIGMAS, np.exp(-FRAME_PERIOD / self._TIME_CONSTANTS)
        self.numbers: FloatArray = np.stack([sigmas, decay, np.sqrt(1.0 - decay**2) * sigmas])
        """Standard deviations, decays in a step and fresh parts of the process, (3, 6)."""


@dataclass(frozen=True)
class Head:
    """A pan-tilt head whose axes meet half-way between the two cameras, `baseline` m apart.

    R_wc = R_wb R_y(pan) R_x(tilt), where B is where the left camera is when the head looks straight ahead: positive pan
    looks right, positive tilt looks up. `max_angles` and `max_rates` are the largest pan and tilt to either side, rad,
    and the fastest, rad/s.
    """

    baseline: float
    max_angles: tuple[float, float]
    max_rates: tuple[float, float]

    def turned(self, angles: FloatArray, command: FloatArray, dt: float | FloatArray) -> FloatArray:
        """Pan and tilt, rad, after `dt` s of turning from `angles` (2,) towards a command (2,) in -1..1 of the limits.

        Arguments are broadcast.
        """
        most = np.array(self.max_rates) * dt
        after: FloatArray = angles + np.clip(command * self.max_angles - angles, -most, most)
        return after

    def camera_pose(self, body: Pose, angles: FloatArray) -> Pose:
        """Pose of the left camera, from its pose when looking straight ahead and pan and tilt, rad."""
        return body @ self._turned(angles)

    def body_pose(self, camera: Pose, angles: FloatArray) -> Pose:
        """Inverse of `camera_pose`: where the left camera would be if the head looked straight ahead."""
        return camera @ self._turned(angles).inverse()

    def _turned(self, angles: FloatArray) -> Pose:
        """Pose of the left camera in the frame that it has straight ahead."""
        turn, middle = head_turn(angles), np.array([0.5 * self.baseline, 0.0, 0.0])
        return Pose(middle - rotations.matrix(turn) @ middle, turn)


def head_turn(angles: FloatArray) -> FloatArray:
    """Quaternion xyzw of R_y(pan) R_x(tilt); (..., 2) rad -> (..., 4)."""
    (sin_pan, sin_tilt), (cos_pan, cos_tilt) = np.sin(0.5 * angles.T), np.cos(0.5 * angles.T)
    return np.array([cos_pan * sin_tilt, sin_pan * cos_tilt, -sin_pan * sin_tilt, cos_pan * cos_tilt]).T
