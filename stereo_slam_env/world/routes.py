"""Scripted routes: speed and yaw rate over time, and the camera motion that follows them (Eq. 6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from filters import rotations
from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Pose, Velocity

FRAME_PERIOD = 0.1
"""Seconds between two frames of every rig."""
_REACH = 30.0


@dataclass(frozen=True, eq=False)
class Route:
    """A nominal drive on flat ground, in W.

    Attributes
    ----------
    name : str
        Key in `ROUTES`, or path of a pose file: what `route_files.named_route` takes.
    speeds : (K - 1,)
        Speed of each step, m/s.
    yaw_rates : (K - 1,)
        About the camera's y axis (down), rad/s: positive turns right.
    straight_below : float
        Yaw rate up to which it counts as driving straight ahead, rad/s.
    """

    name: str
    speeds: FloatArray
    yaw_rates: FloatArray
    straight_below: float = 1e-3

    @property
    def frames(self) -> int:
        """Number of frames K; the first one is in the origin of W."""
        return len(self.speeds) + 1

    @cached_property
    def headings(self) -> FloatArray:
        """Yaw at each frame, rad; (K,)."""
        return np.concatenate([[0.0], np.cumsum(self.yaw_rates * FRAME_PERIOD)])

    @cached_property
    def middle_headings(self) -> FloatArray:
        """Yaw half-way through each step, the direction of travel, rad; (K - 1,)."""
        return 0.5 * (self.headings[1:] + self.headings[:-1])

    @cached_property
    def travel(self) -> FloatArray:
        """Rotation of a camera that looks in the direction of travel of each step; (K - 1, 3, 3)."""
        return np.array([rotations.exp([0.0, yaw, 0.0]) for yaw in self.middle_headings])

    @cached_property
    def attitudes(self) -> FloatArray:
        """Nominal rotation R_wc of the camera at each frame; (K, 3, 3)."""
        return np.array([rotations.exp([0.0, yaw, 0.0]) for yaw in self.headings])

    @cached_property
    def positions(self) -> FloatArray:
        """Nominal camera position at each frame, m in W; (K, 3)."""
        yaw = self.middle_headings
        velocity = self.speeds[:, None] * np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], axis=1)
        return np.concatenate([np.zeros((1, 3)), np.cumsum(velocity * FRAME_PERIOD, axis=0)])

    @cached_property
    def arc_length(self) -> FloatArray:
        """Distance along the route at each frame, m; (K,)."""
        return np.concatenate([[0.0], np.cumsum(self.speeds * FRAME_PERIOD)])

    @property
    def length(self) -> float:
        """Whole distance, m."""
        return float(self.arc_length[-1])

    @property
    def duration(self) -> float:
        """Of the whole drive, s."""
        return len(self.speeds) * FRAME_PERIOD

    def turns(self, least: float) -> list[tuple[int, int]]:
        """First and last frame of every turn by more than `least` rad."""
        turning = np.abs(self.yaw_rates) > self.straight_below
        edges = np.flatnonzero(np.diff(np.concatenate([[False], turning, [False]]).astype(int))).reshape(-1, 2)
        turned = np.abs(self.headings[edges[:, 1]] - self.headings[edges[:, 0]])
        return [(int(first), int(last)) for first, last in edges[turned > least]]

    def nearest(self, position: FloatArray, around: int | None = None) -> int:
        """Index of the frame whose nominal position is nearest to `position` (3,) in W.

        Parameters
        ----------
        position : (3,)
            m in W.
        around : int, optional
            Consider only frames less than 30 m along the route from this one: which pass it is where a route
            crosses or retraces itself.
        """
        first, last = 0, self.frames
        if around is not None:
            middle = self.arc_length[around]
            first = int(self.arc_length.searchsorted(middle - _REACH))
            last = int(self.arc_length.searchsorted(middle + _REACH, side="right"))
        away = ((self.positions[first:last] - position) ** 2).sum(axis=1)
        return first + int(away.argmin())


def pulse(time: FloatArray, start: float, end: float, ramp: float) -> FloatArray:
    """1 between `start` and `end`, 0 outside, with raised-cosine ramps of `ramp` seconds inside the window."""
    edge = np.minimum(time - start, end - time) / ramp
    return (0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))).astype(np.float64)


def _step_times(frames: int) -> FloatArray:
    return (np.arange(frames - 1, dtype=np.float64) + 0.5) * FRAME_PERIOD


def straight() -> Route:
    """200 frames straight ahead at 4.9 m/s."""
    speeds = np.full(199, 4.9)
    return Route("straight", speeds, np.zeros_like(speeds))


def right_turn() -> Route:
    """80 frames: forward for half a second, then 90 degrees to the right (the situation of the paper's 4.3)."""
    time = _step_times(80)
    yaw_rate = (np.pi / 2) / 3.5
    return Route("right-turn", np.full_like(time, 4.0), yaw_rate * pulse(time, 0.5, 5.0, 1.0))


def town() -> Route:
    """800 frames, about 350 m, with one wide turn to the left and one to the right (the paper's 4.4)."""
    time = _step_times(800)
    speeds, yaw_rates = np.full_like(time, 4.9), np.zeros_like(time)
    for start, end, yaw_rate in ((25.0, 31.0, -0.29), (60.0, 66.0, 0.29)):
        speeds -= 1.9 * pulse(time, start - 4.0, end + 4.0, 4.0)
        yaw_rates += yaw_rate * pulse(time, start, end, 1.2)
    return Route("town", speeds, yaw_rates)


def loop() -> Route:
    """790 frames: round a block by four right turns, through the start pose at frame 740, 24 m further."""
    turn, ramp, sides = 6.0, 1.2, (14.0, 11.0)
    starts = 0.5 * sides[0] + np.cumsum([0.0, *(turn + side for side in (sides[1], sides[0], sides[1]))])
    time = _step_times(790)
    speeds, yaw_rates = np.full_like(time, 4.9), np.zeros_like(time)
    for start in starts:
        speeds -= 1.9 * pulse(time, start - 2.0, start + turn + 2.0, 2.0)
        yaw_rates += (np.pi / 2) / (turn - ramp) * pulse(time, start, start + turn, ramp)
    return Route("loop", speeds, yaw_rates)


ROUTES: dict[str, Callable[[], Route]] = {
    "straight": straight,
    "right-turn": right_turn,
    "town": town,
    "loop": loop,
}


class Driver(Protocol):
    """What moves the camera."""

    @property
    def finished(self) -> bool:
        """Whether the end of the route is reached."""

    def start(self) -> tuple[Pose, Velocity]:
        """Pose and velocity of the first frame."""

    def drive(self, pose: Pose, action: FloatArray) -> Velocity:
        """Velocity (v in W, omega in the camera frame) of the next step from `pose`."""


class RouteDriver:
    """Drives the camera along a route with small, bounded perturbations.

    The velocity of each step is the nominal one, plus an Ornstein-Uhlenbeck process on the three linear and the three
    angular components, minus a pull back to the nominal pose that keeps height, roll, pitch and the lane.

    Parameters
    ----------
    route : Route
        The nominal drive.
    perturbation : float
        Scale of the perturbations: 0 drives the nominal route exactly.
    rng : numpy.random.Generator
        Source of the perturbations.
    """

    _SIGMAS = np.array([0.08, 0.08, 0.15, 0.012, 0.008, 0.012])
    _TIME_CONSTANTS = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    _PULL = 0.5
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
        pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        return pose, self._velocity(pose, 0)

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
            R_travel @ (along + self._disturbance[:3] - self._PULL * offset),
            turn + self._disturbance[3:] - self._PULL * tilt,
        )


def advance(pose: Pose, velocity: Velocity, dt: float) -> Pose:
    """Eq. 6: r' = r + v dt, q' = q x q(omega dt)."""
    return Pose(
        pose.position + velocity.linear * dt,
        rotations.multiply(pose.orientation, rotations.exp_quaternion(velocity.angular * dt)),
    )
