"""`StereoSlam/ClosedLoop-v0`: the driver follows its route by the filter's estimate, which may be late."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from filters.contract.validation import whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.envs.how_to_learn import STEERING
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper, Seeds, Step
from stereo_slam_env.policies.registry import Action
from stereo_slam_env.policies.rows import follow_route
from stereo_slam_env.simulator.motion import nearest_frames, routes_ahead
from stereo_slam_env.simulator.state import ARENA
from stereo_slam_env.tasks.levels import inner_environment, of_world
from stereo_slam_env.world.vehicle import Head
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, SelectedKeys
from stereo_slam_env.wrappers.filter_rows import FilterRows
from stereo_slam_env.wrappers.row_wrapper import RowWrapper
from stereo_slam_env.wrappers.vectors import vector_of

KEYS = ("belief_sigmas", "car", "odometry", "progress", "route")
LATENCIES: Mapping[str, int] = MappingProxyType({"easy": 1, "normal": 3, "hard": 4})
"""Age of the estimate at each level, frames: the later it is, the slower one has to drive."""
_SLOW = 5.0
"""Speed of `drive_slowly`, m/s."""


class RouteByEstimateRows(RowsWrapper):
    """What `RouteByEstimate` does, on rows; see there."""

    changes = ("_poses", "_nearest", "_progress")
    training: ClassVar[Mapping[str, Any]] = {**STEERING, "decisions": 393_216}

    def __init__(self, rows: Rows, latency: int) -> None:
        super().__init__(rows)
        self._latency = whole_number("latency", latency, 0)
        self._beliefs: FilterRows = self.needed("beliefs")
        self._head: Head | None = self.needed("head")
        self._poses = np.zeros((self._latency + 1, rows.count, 7))
        """The latest estimates of the camera if the head looked straight ahead, the newest first."""
        self._nearest, self._progress = np.zeros(rows.count, dtype=np.int64), np.zeros(rows.count)

    def begin(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """See `Rows`; the start is known, so the estimate is not late yet."""
        self.rows.begin(chosen, seeds, options)
        self._poses[:, chosen] = self._bodies()[chosen]
        self._nearest[chosen], self._progress[chosen] = 0, 0.0

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`; drive, and find the place on the route by the estimate."""
        step = self.rows.advance(actions, going)
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

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`."""
        observation, info = self.rows.look()
        progress = self._progress[:, None].astype(np.float32)
        return {**observation, "route": self.route_shown(), "progress": progress}, info

    def route_shown(self) -> Any:
        """The key `route` of all rows."""
        ahead = []
        for b in range(self.count):
            route, pose = self.world.route_of(b), self._poses[-1, b : b + 1]
            ahead.append(routes_ahead(route.positions, route.arc_length, self._nearest[b : b + 1], pose, ARENA)[0])
        return np.array(ahead)


class RouteByEstimate(RowWrapper):
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

    OnRows = RouteByEstimateRows

    def __init__(self, env: gym.Env[Any, Any], latency: int = 0) -> None:
        super().__init__(env)


def closed_loop(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    filter: str = "right-invariant",
    filter_options: Mapping[str, Any] | None = None,
    latency: int | None = None,
    many: Mapping[str, Any] | None = None,
    **world: Any,
) -> Any:
    """`StereoSlam/ClosedLoop-v0`: come to the end of a route that is only known relative to an estimate.

    The action is that of `StereoSlam/Drive-v0`, `Box(-1, 1, (2,))`: acceleration and steering. The observation has
    `route` (5, 2) and `progress` (1,) by the estimate of 0.3 s ago (`RouteByEstimate`), `car` (2,), `odometry` (6,) and
    `belief_sigmas` (6,). The reward is that of `StereoSlam/Drive-v0` without the one for tracked landmarks: 0.1 for
    each metre, less beside the route, 10 for its end, minus 10 for a collision or for more than 2 m beside it, minus
    0.4 for each second. At most 1200 steps.

    Parameters
    ----------
    render_mode : str, optional
        That of `StereoSlam/Drive-v0`.
    level : {"easy", "normal", "hard"}
        Difficulty, see `LEVELS`.
    arguments : mapping, optional
        Of `StereoSlam/Drive-v0`; JSON-able. Unless given here, there are 40 landmarks at most, and the odometry is that
        of a car: 0.2 m/s and 0.02 rad/s.
    filter : str
        Name of the filter that is driven by.
    filter_options : mapping, optional
        Its options.
    latency : int, optional
        Of `RouteByEstimate`; None: that of the level in `LATENCIES`.
    many : mapping, optional
        `num_envs`, `scenes` and `threads`: that many in rows, instead of one environment.
    **world
        Arguments of `StereoSlam/Drive-v0`, as in `arguments`.
    """
    odometry = {"odometry_sigma_linear": 0.2, "odometry_sigma_angular": 0.02}
    own = {"render_mode": render_mode, "max_landmarks": 40, "tracking_weight": 0.0, **odometry}
    inside = inner_environment("StereoSlam/Drive-v0", level, of_world(arguments, world), many, **own)
    inside = BeliefPanorama.around(BeliefObservation.around(inside, filter=filter, options=filter_options))
    latency = LATENCIES[level] if latency is None else latency
    return SelectedKeys.around(RouteByEstimate.around(inside, latency=latency), keys=KEYS)


closed_loop_vector = vector_of(closed_loop)


def drive_slowly(observation: Mapping[str, Any], actions: int = 2) -> Action:
    """`follow_route` at no more than 5 m/s: a late estimate then is less far behind, and more is seen."""
    return follow_route(observation, actions, speed=_SLOW)
