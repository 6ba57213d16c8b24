"""`StereoSlam/ClosedLoop-v0`: the driver follows its route by the filter's estimate, which may be late."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import FloatArray, positive, whole_number
from stereo_slam_env.envs.stereo_env import route_ahead
from stereo_slam_env.policies.interface import Action
from stereo_slam_env.policies.scores import follow_route
from stereo_slam_env.tasks.levels import inner_environment
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, SelectedKeys
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper

KEYS = ("belief_sigmas", "car", "odometry", "progress", "route")
_SLOW = 5.0
"""Speed of `drive_slowly`, m/s."""


class RouteByEstimate(RecordedWrapper):
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

    def __init__(self, env: gym.Env[Any, Any], latency: int = 0, leeway: float = 2.0) -> None:
        super().__init__(env)
        self._leeway = positive("leeway", leeway)
        self._poses: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=whole_number("latency", latency, 0) + 1)
        self.inner("slam")
        self._price = float(self.inner("options").collision_weight)
        self._nearest = self._true_nearest = 0
        self._progress = 0.0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment; the start is known, so the estimate is not late yet."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._poses.clear()
        self._nearest = self._true_nearest = 0
        self._progress = 0.0
        return self._by_estimate(observation), {**info, "cross_track": self._cross_track()}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drive, and look at the route by the estimate."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        info["cross_track"] = self._cross_track()
        if info["cross_track"] > self._leeway and not info["reward_collision"]:
            reward = float(reward) - self._price - info["reward_goal"]
            missed = {"reward_collision": -self._price, "reward_goal": 0.0}
            info.update({name: np.float64(value) for name, value in missed.items()}, is_success=np.bool_(False))
            terminated = True
        return self._by_estimate(observation), float(reward), terminated, truncated, info

    def _cross_track(self) -> np.float64:
        """Distance of the car from the line of its route, m."""
        route, position = self.inner("route"), self.inner("body").position
        self._true_nearest = route.nearest(position, around=self._true_nearest)
        right = route.attitudes[self._true_nearest][:, 0]
        return np.float64(abs(right @ (position - route.positions[self._true_nearest])))

    def _by_estimate(self, observation: dict[str, Any]) -> dict[str, Any]:
        pose, route = self.inner("slam").pose, self.inner("route")
        self._poses.append((pose.position, pose.orientation))
        position, orientation = self._poses[0]
        self._nearest = route.nearest(position, around=self._nearest)
        self._progress = max(self._progress, float(route.arc_length[self._nearest]) / route.length)
        ahead = route_ahead(route, np.array([self._nearest]), position[None], orientation[None])[0]
        return {**observation, "route": ahead, "progress": np.array([self._progress], dtype=np.float32)}


def closed_loop(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    filter: str = "right-invariant",
    filter_options: Mapping[str, Any] | None = None,
    latency: int = 2,
    leeway: float = 2.0,
) -> gym.Env[Any, Any]:
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
    """
    odometry = {"odometry_sigma_linear": 0.2, "odometry_sigma_angular": 0.02}
    own = {"render_mode": render_mode, "max_landmarks": 40, "tracking_weight": 0.0, **odometry}
    env = inner_environment("StereoSlam/Drive-v0", level, arguments or {}, **own)
    env = BeliefPanorama(BeliefObservation(env, filter, options=filter_options))
    return SelectedKeys(RouteByEstimate(env, latency, leeway), KEYS)


def drive_slowly(observation: Mapping[str, Any], actions: int = 2) -> Action:
    """`follow_route` at no more than 5 m/s: a late estimate then is less far behind, and more is seen."""
    action = follow_route(observation, actions)
    if observation["car"][0] > _SLOW:
        action[0] = min(action[0], -0.5)
    return action
