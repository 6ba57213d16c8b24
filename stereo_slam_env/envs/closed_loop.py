"""`StereoSlam/ClosedLoop-v0`: the driver follows its route by a late estimate; `DriveChoices`: a script steers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.contract.validation import positive, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.row_wrapper import RowsWrapper
from stereo_slam_env.envs.rows import Arrays, Seeds, Step
from stereo_slam_env.envs.task_env import TaskEnv
from stereo_slam_env.simulator.motion import nearest_frames, routes_ahead
from stereo_slam_env.simulator.state import ARENA
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.vehicle import Car, Head

_STEER_BY, _BRAKE_BY = 1, 3
"""Points of the observation `route`: the one to steer to, and the farthest one to be slow enough for."""


def follow_route(
    observation: Mapping[str, Any],
    actions: int = 2,
    *,
    speed: float | FloatArray = Car.max_speed,
    lateral: float = 3.0,
    beside: float = 0.0,
) -> NDArray[np.float32]:
    """Action that drives along the route that the observation shows (pure pursuit); the head looks straight ahead.

    Steers along the circle through the rear axle and the point 5 m ahead, and keeps slow enough for the circles to all
    points up to 20 m ahead.

    Parameters
    ----------
    observation : mapping
        With `car` (..., 2) and `route` (..., 5, 2), from environments in which the agent drives.
    actions : int
        Entries of the action; those after the first two are 0.
    speed : float or (...)
        Largest one, m/s.
    lateral : float
        Largest acceleration across the direction of travel, m/s^2.
    beside : float
        How far to the right of the route to drive, m.
    """
    car = Car()
    now = np.asarray(observation["car"], dtype=np.float64)[..., 0]
    right, forward = np.moveaxis(np.asarray(observation["route"], dtype=np.float64), -1, 0)
    right, forward = right + beside, forward + car.camera_forward
    curvatures = 2.0 * right / np.maximum(right**2 + forward**2, 1.0)
    bend = np.abs(curvatures[..., _STEER_BY : _BRAKE_BY + 1]).max(axis=-1)
    speed_wanted = np.minimum(speed, np.sqrt(lateral / np.maximum(bend, 1e-6)))
    action = np.zeros((*now.shape, actions), dtype=np.float32)
    action[..., 0] = np.clip((speed_wanted - now) / (car.max_acceleration * FRAME_PERIOD), -1.0, 1.0)
    action[..., 1] = np.clip(np.arctan(car.wheelbase * curvatures[..., _STEER_BY]) / car.max_steering, -1.0, 1.0)
    return action


class DriveChoices(RowsWrapper):
    """An agent that chooses a speed and a direction of gaze every second, or stops; `follow_route` steers.

    The action is `Discrete(1 + S P)`: 0 stops, 1 + P s + p is the speed number s and the gaze number p. So what is to
    be learnt is where to look, how fast to drive, and when to stop, and not how to keep a lane; a return is that of the
    environment inside.

    Parameters
    ----------
    env : gymnasium.Env
        In which the agent drives and turns its head, and an entry of the action stops.
    speeds : (S,) sequence of float
        Largest speed, m/s.
    pans : (P,) sequence of float
        Shares of the largest pan, positive to the right.
    hold : int
        Steps for which a choice holds.
    stop : int
        Entry of the action that stops if it is 1.
    """

    def __init__(
        self,
        env: Any,
        speeds: Sequence[float] = (5.0, 8.0),
        pans: Sequence[float] = (-0.35, 0.0, 0.35),
        hold: int = 10,
        stop: int = 2,
    ) -> None:
        super().__init__(env)
        self._hold, self._stop = whole_number("hold", hold, 1), whole_number("stop", stop, 2)
        pairs = [(positive("speeds", speed), pan) for speed in speeds for pan in pans]
        self._speeds, pan = np.array([(0.0, 0.0), *pairs]).T
        try:
            self._route = env.get_attr("route_shown")  # by an estimate
        except AttributeError:
            self._route = partial(self.world.shown, "route")
        self._entries: int = env.action_space.shape[0]
        self._pans = np.zeros((len(pan), self._entries), dtype=np.float32)
        self._pans[:, -2], self._pans[0, stop] = pan, 1.0
        self.action_space = spaces.Discrete(len(pan))

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Drive as was chosen until the choice ends, or the episode."""
        decisions = np.asarray(actions)
        total, over, late, still = np.zeros(self.num_envs), ~going, np.zeros_like(going), going
        for _ in range(self._hold):
            info = {"car": self.world.shown("car"), "route": self._route()}
            driven = follow_route(info, self._entries, speed=self._speeds[decisions])
            rewards, ended, cut = self.rows.step(driven + self._pans[decisions], still)
            total, over, late = total + rewards, over | ended | cut, late | cut
            still = going & ~over
            if not still.any():
                break
        return total, going & over & ~late, late


LATENCIES: Mapping[str, int] = MappingProxyType({"easy": 1, "normal": 3, "hard": 4})
"""Age of the estimate at each level, frames: the later it is, the slower one has to drive."""
_SLOW = 5.0
"""Speed of `drive_slowly`, m/s."""


class RouteByEstimate(RowsWrapper):
    """Shows the route as the filter believes to see it.

    The keys `route` and `progress` of the observation are computed from the pose that the filter estimated `latency`
    frames ago, and no longer from the truth. So an error of the filter moves the car, and the car moves what the filter
    sees next.

    Parameters
    ----------
    env : gymnasium.Env
        In which the agent drives, with `BeliefObservation` around it.
    latency : int
        Frames.
    """

    def __init__(self, env: Any, latency: int = 0) -> None:
        super().__init__(env)
        self._latency = whole_number("latency", latency, 0)
        self._beliefs: FilterRows = self.needed("beliefs")
        self._head: Head | None = self.needed("head")
        self._poses = np.zeros((self._latency + 1, self.num_envs, 7))
        """The latest estimates of the camera if the head looked straight ahead, the newest first."""
        self._nearest, self._progress = np.zeros(self.num_envs, dtype=np.int64), np.zeros(self.num_envs)

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """The start is known, so the estimate is not late yet."""
        self.rows.reset(chosen, seeds, options)
        self._poses[:, chosen] = self._bodies()[chosen]
        self._nearest[chosen], self._progress[chosen] = 0, 0.0

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Drive, and find the place on the route by the estimate."""
        step = self.rows.step(actions, going)
        self._poses[1:, going] = self._poses[:-1, going]
        self._poses[0, going] = self._bodies()[going]
        for b in np.flatnonzero(going).tolist():
            route, place = self.world.route_of(b), self._poses[-1, b : b + 1, :3]
            at = nearest_frames(route.positions, route.arc_length, place, self._nearest[b : b + 1])
            self._nearest[b] = at[0]
            self._progress[b] = max(self._progress[b], route.arc_length[at[0]] / route.length)
        return step

    def _bodies(self) -> FloatArray:
        """Estimated poses without the turn of the head, (B, 7)."""
        poses = self._beliefs.poses
        if self._head is None:
            return poses
        bodies = np.empty_like(poses)
        for b, (pose, angles) in enumerate(zip(poses, self.world.angles(), strict=True)):
            body = self._head.body_pose(Pose(pose[:3], pose[3:]), angles)
            bodies[b] = *body.position, *body.orientation
        return bodies

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        progress = self._progress[:, None].astype(np.float32)
        return {**observation, "route": self.route_shown(), "progress": progress}, info

    def route_shown(self) -> Any:
        """The key `route` of all rows."""
        ahead = []
        for b in range(self.num_envs):
            route, pose = self.world.route_of(b), self._poses[-1, b : b + 1]
            ahead.append(routes_ahead(route.positions, route.arc_length, self._nearest[b : b + 1], pose, ARENA)[0])
        return np.array(ahead)


class ClosedLoop(TaskEnv):
    """Come to the end of a route in time, driving by an estimate that is late.

    ## Description

    The car is driven by what a SLAM filter believes: the points of the route ahead, and the progress, are computed from
    the pose that the filter estimated `latency` frames ago. An error of the filter moves the car, and the car moves
    what the filter sees next. Route, street, sensors and truth are those of `StereoSlam/Drive-v0`; the odometry is that
    of a car, 0.2 m/s and 0.02 rad/s, and there are 40 landmarks at most.

    ## Action Space

    That of `StereoSlam/Drive-v0`, `Box(-1, 1, (2,), float32)`: acceleration and steering angle.

    ## Observation Space

    `Dict`:

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `belief_sigmas` | (6,) | float32 | standard deviations of the pose: position in W, m; rotation, rad |
    | `car` | (2,) | float32 | speed, m/s, and steering angle, rad, without error |
    | `odometry` | (6,) | float32 | noisy mean velocity over the last step, m/s and rad/s |
    | `progress` | (1,) | float32 | share of the route that has been driven, by the estimate |
    | `route` | (5, 2) | float32 | points 2 to 30 m ahead, right and forward of the car by the late estimate, m |

    ## Rewards

    That of `StereoSlam/Drive-v0` without the term for tracked landmarks, each term in `info`: *reward_progress*, 0.1
    for each metre x (1 - (`cross_track` / 2 m)^2); *reward_goal*, 10 at the end; *reward_collision*, -10 for a
    collision, for 2 m beside the route, and where the mean speed is below 6 m/s; *reward_time*, -0.4 for each second;
    *reward_jerk*, -0.05 for each second x (jerk / 10 m/s^3)^2. So who creeps does not arrive, and who jerks pays.

    ## Episode End

    - Termination: the end of the route (`is_success`), or one of those failures (`failed`).
    - Truncation: after 1200 steps.

    ## Arguments

    `latency`, frames: 1 at the level easy, 3 at normal, 4 at hard; `filter` (`"right-invariant"`; `"dead-reckoning"`
    shows what driving is like without a camera), `filter_options`, `level`, `keys`, `observation`, `arguments`, and
    those of `StereoSlam/Drive-v0`.

    ## Training

    `stereo-slam train --environment StereoSlam/ClosedLoop-v0`. What careless drivers, rules and networks score is on
    the page of the tasks.

    ## Version History

    * v0: first version.
    """

    world = "StereoSlam/Drive-v0"
    settings = MappingProxyType(
        {
            **{"max_landmarks": 40, "tracking_weight": 0.0},
            **{"odometry_sigma_linear": 0.2, "odometry_sigma_angular": 0.02},
        }
    )
    filter, filter_options = "right-invariant", None
    parts = ((RouteByEstimate, {}),)
    levels = MappingProxyType({name: {"latency": frames} for name, frames in LATENCIES.items()})
    keys = ("belief_sigmas", "car", "odometry", "progress", "route")


closed_loop_vector = ClosedLoop.vector


def drive_slowly(observation: Mapping[str, Any], actions: int = 2) -> NDArray[np.float32]:
    """`follow_route` at no more than 5 m/s: a late estimate then is less far behind, and more is seen."""
    return follow_route(observation, actions, speed=_SLOW)
