"""`StereoSlam/ClosedLoop-v0`: the driver follows its route by the filter's estimate, which may be late."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import BoolArray, positive, whole_number
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper, Seeds, Step
from stereo_slam_env.policies.interface import Action
from stereo_slam_env.policies.scores import follow_route
from stereo_slam_env.simulator.motion import nearest_frames, routes_ahead
from stereo_slam_env.simulator.state import ARENA
from stereo_slam_env.tasks.levels import inner_environment
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, SelectedKeys
from stereo_slam_env.wrappers.filter_rows import FilterRows
from stereo_slam_env.wrappers.recorded_wrapper import RowWrapper
from stereo_slam_env.wrappers.vectors import vector_of

KEYS = ("belief_sigmas", "car", "odometry", "progress", "route")
_SLOW = 5.0
"""Speed of `drive_slowly`, m/s."""


class RouteByEstimateRows(RowsWrapper):
    """What `RouteByEstimate` does, on rows; see there."""

    changes = ("_poses", "_nearest", "_true_nearest", "_progress", "_cross_track", "_missed")

    def __init__(self, rows: Rows, latency: int, leeway: float) -> None:
        super().__init__(rows)
        self._leeway = positive("leeway", leeway)
        self._latency = whole_number("latency", latency, 0)
        self._beliefs: FilterRows = self.needed("beliefs")
        self._price, self._route = float(self.needed("options").collision_weight), self.needed("route")
        self._poses = np.zeros((self._latency + 1, rows.count, 7))
        """The latest estimates, the newest first."""
        self._nearest, self._true_nearest = (np.zeros(rows.count, dtype=np.int64) for _ in range(2))
        self._progress, self._cross_track = np.zeros(rows.count), np.zeros(rows.count)
        self._missed = np.zeros(rows.count, dtype=np.bool_)

    def begin(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """See `Rows`; the start is known, so the estimate is not late yet."""
        self.rows.begin(chosen, seeds, options)
        self._poses[:, chosen] = self._beliefs.poses[chosen]
        self._nearest[chosen], self._true_nearest[chosen], self._progress[chosen] = 0, 0, 0.0
        self._missed[chosen] = False
        self._see(chosen)

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`; drive, and look at the route by the estimate."""
        rewards, terminated, truncated = self.rows.advance(actions, going)
        self._poses[1:, going] = self._poses[:-1, going]
        self._poses[0, going] = self._beliefs.poses[going]
        self._see(going)
        missed = (self._cross_track > self._leeway) & (self.world.told("reward_collision") == 0.0)
        self._missed[going] = missed[going]
        rewards = np.where(going & missed, rewards - self._price - self.world.told("reward_goal"), rewards)
        return rewards, terminated | (going & missed), truncated

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`."""
        observation, info = self.rows.look()
        poses = np.ascontiguousarray(self._poses[-1])
        positions, arc_length = self._route.positions, self._route.arc_length
        route = routes_ahead(positions, arc_length, self._nearest, poses, ARENA)
        observation |= {"route": route, "progress": self._progress[:, None].astype(np.float32)}
        missed = {"reward_collision": -self._price, "reward_goal": 0.0, "is_success": False}
        changed = {name: np.where(self._missed, value, np.asarray(info[name])) for name, value in missed.items()}
        return observation, {**info, **changed, "cross_track": self._cross_track.copy()}

    def _see(self, which: BoolArray) -> None:
        """Where some rows are on their route, truly and by their late estimates."""
        route = self._route
        truly = np.array([self.world.body(b).position for b in range(self.count)])
        nearest = nearest_frames(route.positions, route.arc_length, truly, self._true_nearest)
        self._true_nearest[which] = nearest[which]
        rights, away = route.attitudes[nearest][:, :, 0].T, (truly - route.positions[nearest]).T
        aside = rights[0] * away[0] + rights[1] * away[1] + rights[2] * away[2]
        self._cross_track[which] = np.abs(aside)[which]
        estimated = np.ascontiguousarray(self._poses[-1, :, :3])
        nearest = nearest_frames(route.positions, route.arc_length, estimated, self._nearest)
        self._nearest[which] = nearest[which]
        progress = np.maximum(self._progress, route.arc_length[nearest] / route.length)
        self._progress[which] = progress[which]


class RouteByEstimate(RowWrapper):
    """Shows the route as the filter believes to see it, and ends the episode when the car is off its lane.

    The keys `route` and `progress` of the observation are computed from the pose that the filter estimated `latency`
    frames ago, and no longer from the truth. So an error of the filter moves the car, and the car moves what the filter
    sees next. `info` gains `cross_track`, the distance of the car from its route, m; from `leeway` on the episode ends
    as with a collision: `reward_collision`, and no `is_success`.

    Parameters
    ----------
    env : gymnasium.Env
        In which the agent drives, its head straight ahead if it has one, with `BeliefObservation` around it.
    latency : int
        Frames.
    leeway : float
        m.
    """

    OnRows = RouteByEstimateRows

    def __init__(self, env: gym.Env[Any, Any], latency: int = 0, leeway: float = 2.0) -> None:
        super().__init__(env)


def closed_loop(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    filter: str = "right-invariant",
    filter_options: Mapping[str, Any] | None = None,
    latency: int = 2,
    leeway: float = 2.0,
    many: Mapping[str, Any] | None = None,
) -> Any:
    """`StereoSlam/ClosedLoop-v0`: come to the end of a route that is only known relative to an estimate.

    The action is that of `StereoSlam/Drive-v0`, `Box(-1, 1, (2,))`: acceleration and steering. The observation has
    `route` (5, 2) and `progress` (1,) by the estimate of 0.2 s ago (`RouteByEstimate`), `car` (2,), `odometry` (6,) and
    `belief_sigmas` (6,). The reward is that of `StereoSlam/Drive-v0` without the one for tracked landmarks: 0.1 for
    each metre, 10 for the end of the route, minus 10 for a collision or for more than 2 m beside the route, minus 0.05
    for each second. At most 1200 steps.

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
    latency, leeway
        Of `RouteByEstimate`.
    many : mapping, optional
        `num_envs`, `scenes` and `threads`: that many in rows, instead of one environment.
    """
    odometry = {"odometry_sigma_linear": 0.2, "odometry_sigma_angular": 0.02}
    own = {"render_mode": render_mode, "max_landmarks": 40, "tracking_weight": 0.0, **odometry}
    inside = inner_environment("StereoSlam/Drive-v0", level, arguments or {}, many, **own)
    inside = BeliefPanorama.around(BeliefObservation.around(inside, filter=filter, options=filter_options))
    return SelectedKeys.around(RouteByEstimate.around(inside, latency=latency, leeway=leeway), keys=KEYS)


closed_loop_vector = vector_of(closed_loop)


def drive_slowly(observation: Mapping[str, Any], actions: int = 2) -> Action:
    """`follow_route` at no more than 5 m/s: a late estimate then is less far behind, and more is seen."""
    action = follow_route(observation, actions)
    if observation["car"][0] > _SLOW:
        action[0] = min(action[0], -0.5)
    return action
