"""A car that an agent drives: the kinematic bicycle model on flat ground, with the camera on its roof."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Pose, Velocity
from stereo_slam_env.world.routes import FRAME_PERIOD, Route


@dataclass(frozen=True)
class Car:
    """What the car can do, and how big it is.

    Attributes
    ----------
    wheelbase : float
        m.
    camera_forward : float
        From the rear axle to the left camera, m.
    max_speed, max_acceleration, max_steering, max_steering_rate : float
        m/s, m/s^2, rad at the front wheels, rad/s.
    size : (3,) tuple
        Length, width, height of the body, m.
    body_c : (3,) tuple
        Centre of the body in the left camera frame, m.
    """

    wheelbase: float = 2.7
    camera_forward: float = 1.6
    max_speed: float = 12.0
    max_acceleration: float = 3.0
    max_steering: float = 0.55
    max_steering_rate: float = 1.0
    size: tuple[float, float, float] = (4.2, 1.8, 1.1)
    body_c: tuple[float, float, float] = (0.0, 0.8, -0.25)


class AgentDriver:
    """Turns actions into camera motion.

    Parameters
    ----------
    car : Car
        Limits and geometry.
    route : Route
        Where the street is; the car starts at its first point with its first speed.
    """

    def __init__(self, car: Car, route: Route) -> None:
        self.car, self.route = car, route
        self.speed = float(route.speeds[0])
        self.steering = 0.0
        self.finished = False
        """Whether the last point of the route is the nearest one."""
        self._nearest = 0
        self._heading = 0.0

    def start(self) -> tuple[Pose, Velocity]:
        """Pose and velocity of the first frame."""
        pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        return pose, Velocity(np.array([0.0, 0.0, self.speed]), np.zeros(3))

    def drive(self, pose: Pose, action: FloatArray) -> Velocity:
        """Mean velocity (v in W, omega in the camera frame) of the next step.

        Parameters
        ----------
        pose : Pose
            Current camera pose.
        action : (2,)
            Acceleration and steering angle in -1..1 of their limits; positive steers right.
        """
        car, dt = self.car, FRAME_PERIOD
        before = self.speed
        self.speed = float(np.clip(before + action[0] * car.max_acceleration * dt, 0.0, car.max_speed))
        most = car.max_steering_rate * dt
        self.steering += float(np.clip(action[1] * car.max_steering - self.steering, -most, most))

        distance = 0.5 * (before + self.speed) * dt
        turn = distance * np.tan(self.steering) / car.wheelbase
        chord = distance * np.sinc(0.5 * turn / np.pi)
        old, middle, new = self._heading, self._heading + 0.5 * turn, self._heading + turn
        moved = chord * _direction(middle) + car.camera_forward * (_direction(new) - _direction(old))
        self._heading = new
        self._nearest = self.route.nearest(pose.position + moved, around=self._nearest)
        self.finished = self._nearest == self.route.frames - 1
        return Velocity(moved / dt, np.array([0.0, turn / dt, 0.0]))


def _direction(heading: float) -> FloatArray:
    return np.array([np.sin(heading), 0.0, np.cos(heading)])
