"""The car, its pan-tilt head, and the drivers that move it along a route or by actions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry import rotations
from filters.geometry.poses import Pose
from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Velocity
from stereo_slam_env.world.routes import FRAME_PERIOD, Route


@dataclass(frozen=True)
class Car:
    """Limits and size of the car, in m, s and rad; steering is that of the front wheels.

    `camera_forward` is from the rear axle to the left camera, `size` length, width and height of the body, and `body_c`
    its centre in the left camera frame.
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
    """Kinematic bicycle model: turns actions into camera motion from the first point and speed of a route on."""

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
        return Pose(), Velocity(np.array([0.0, 0.0, self.speed]), np.zeros(3))

    def drive(self, pose: Pose, action: FloatArray) -> Velocity:
        """Mean velocity (v in W, omega in the camera frame) of the next step from the camera pose.

        The action (2,) is acceleration and steering angle in -1..1 of their limits; positive steers right.
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


class RouteDriver:
    """Drives the camera along a route with small, bounded perturbations; scale 0 drives the nominal route exactly.

    The velocity of each step is the nominal one, plus an Ornstein-Uhlenbeck process on the three linear and the three
    angular components, minus a pull back to the nominal pose that keeps height, roll, pitch and the lane.
    """

    _SIGMAS = np.array([0.08, 0.08, 0.15, 0.012, 0.008, 0.012])
    _TIME_CONSTANTS = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    PULL = 0.5
    """1/s."""

    def __init__(self, route: Route, perturbation: float, rng: np.random.Generator) -> None:
        self.route = route
        self._rng = rng
        self._sigmas = perturbation * self._SIGMAS
        self._decay = np.exp(-FRAME_PERIOD / self._TIME_CONSTANTS)
        self._fresh = np.sqrt(1.0 - self._decay**2) * self._sigmas
        self._disturbance = self._sigmas * rng.standard_normal(6)
        self._step = 0

    def start(self) -> tuple[Pose, Velocity]:
        """Pose and velocity of the first frame."""
        return Pose(), self._velocity(Pose(), 0)

    @property
    def sway(self) -> FloatArray:
        """Standard deviations, decays in a step and fresh parts of the process, (3, 6)."""
        return np.stack([self._sigmas, self._decay, self._fresh])

    @property
    def finished(self) -> bool:
        """Whether the route has no step left."""
        return self._step >= len(self.route.speeds)

    def drive(self, pose: Pose, action: FloatArray) -> Velocity:
        """Velocity (v in W, omega in the camera frame) of the next step from `pose`; the action is not used."""
        self._disturbance = self._decay * self._disturbance + self._fresh * self._rng.standard_normal(6)
        velocity = self._velocity(pose, self._step)
        self._step += 1
        return velocity

    def _velocity(self, pose: Pose, step: int) -> Velocity:
        route = self.route
        R_travel, R_nominal, R_wc = route.travel[step], route.attitudes[step], pose.R_wc
        offset = R_travel.T @ (pose.position - route.positions[step])
        tilt = rotations.log(R_nominal.T @ R_wc)
        along = np.array([0.0, 0.0, route.speeds[step]])
        turn = R_wc.T @ np.array([0.0, route.yaw_rates[step], 0.0])
        return Velocity(
            R_travel @ (along + self._disturbance[:3] - self.PULL * offset),
            turn + self._disturbance[3:] - self.PULL * tilt,
        )


Driver = AgentDriver | RouteDriver


def advance(pose: Pose, velocity: Velocity, dt: float) -> Pose:
    """Eq. 6: r' = r + v dt, q' = q x q(omega dt)."""
    turned = rotations.multiply(pose.orientation, rotations.exp_quaternion(velocity.angular * dt))
    return Pose(pose.position + velocity.linear * dt, turned)


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


def velocity_between(before: Pose, after: Pose, dt: float) -> Velocity:
    """The constant velocity that leads from one pose to the other (Eq. 6)."""
    turn = before.R_wc.T @ after.R_wc
    return Velocity((after.position - before.position) / dt, rotations.log(turn) / dt)
