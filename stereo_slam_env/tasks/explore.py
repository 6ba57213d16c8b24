"""`StereoSlam/Explore-v0`: drive and look until the map is complete enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.validation import BoolArray, positive
from stereo_slam_env.policies.interface import Action
from stereo_slam_env.tasks.closed_loop import drive_slowly
from stereo_slam_env.tasks.levels import inner_environment
from stereo_slam_env.training.task import GAZE_FILTER
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, SelectedKeys
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space

KEYS = ("belief_sigmas", "panorama", "head", "car", "route", "progress", "coverage")
STOP = 2
"""Entry of the action: above `_STOP_ABOVE` the agent ends the episode."""
_STOP_ABOVE = 0.5
_SINCERE = 3.0
"""Standard deviations: an estimate that is farther off than that is not on the map, whatever the filter claims."""
_PERIOD, _PAN = 4.0, 0.7
"""Of the head in `explore_by_sweeping`: time to look to both sides, s, and how far, as a share of the farthest."""


class Coverage(RecordedWrapper):
    """Pays for landmarks that enter the map, and lets the agent stop.

    The landmarks to be mapped are those of the scene no farther from the route than the sensor sees. One is *mapped*
    once the filter knows its position in W with a standard deviation (root of the trace of the covariance) below
    `accuracy`, and the estimate is within three times that of the true position; it then stays mapped. So neither a map
    that is claimed nor a map that is forgotten pays.

    The action has one more entry, number 2: above 0.5 it ends the episode. The observation gains `coverage` (1,), the
    share of the landmarks that is mapped, 0 to 1. `info` gains `coverage`, `path_length` (m), `reward_coverage` and
    `reward_path`; `is_success` is whether the coverage has reached `goal` without a collision.

    Parameters
    ----------
    env : gymnasium.Env
        `StereoSlam/DriveGaze-v0` with `BeliefObservation` around it.
    accuracy : float
        m.
    goal : float
        Share of the landmarks, above 0.
    coverage_weight : float
        Paid for the whole map.
    path_weight : float
        Price of each metre.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        accuracy: float = 0.8,
        goal: float = 0.6,
        coverage_weight: float = 20.0,
        path_weight: float = 0.01,
    ) -> None:
        super().__init__(env)
        self.inner("slam")
        if self.inner("options").sensor != "landmarks":
            raise ValueError(
                "sensor must be 'landmarks': of corners in images nobody knows how many there are to be mapped"
            )
        self._accuracy, self._goal = positive("accuracy", accuracy), positive("goal", goal)
        self._paid = positive("coverage_weight", coverage_weight), positive("path_weight", path_weight, allow_zero=True)
        inner = dict_space(env, "Coverage").spaces
        self.observation_space = spaces.Dict({**inner, "coverage": spaces.Box(0.0, 1.0, (1,), np.float32)})
        assert env.action_space.shape is not None
        self.action_space = spaces.Box(-1.0, 1.0, (env.action_space.shape[0] + 1,), np.float32)
        self._in_reach: BoolArray
        self._mapped: BoolArray
        self._before = np.zeros(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment; nothing is mapped yet."""
        observation, info = self.env.reset(seed=seed, options=options)
        places, road = self.inner("landmark_truth")().positions[:, [0, 2]], self.inner("route").positions[:, [0, 2]]
        away = np.linalg.norm(places[:, None] - road, axis=-1).min(axis=1)
        self._in_reach = away <= self.inner("options").tracking.farthest
        self._mapped = np.zeros(len(places), dtype=bool)
        self._before = np.array([self._look(), float(info["distance"])])
        return self._shown(observation), self._with_rewards(info, np.zeros(2))

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drive, look, and be paid for what is new on the map."""
        stops = bool(action[STOP] > _STOP_ABOVE)
        observation, reward, terminated, truncated, info = self.env.step(np.delete(action, STOP))
        now = np.array([self._look(), float(info["distance"])])
        terms = (now - self._before) * self._paid * [1.0, -1.0]
        self._before = now
        total = float(reward) + float(terms.sum())
        return self._shown(observation), total, terminated or stops, truncated, self._with_rewards(info, terms)

    def _look(self) -> float:
        """The share of the landmarks that is mapped, after a look at the map of the filter."""
        landmarks, truth = self.inner("slam").landmarks, self.inner("landmark_truth")().positions
        sigmas = np.sqrt(np.einsum("nii->n", landmarks.covariances))
        errors = np.linalg.norm(landmarks.positions - truth[landmarks.ids], axis=1)
        self._mapped[landmarks.ids[(sigmas < self._accuracy) & (errors < _SINCERE * self._accuracy)]] = True
        return float(self._mapped[self._in_reach].mean()) if self._in_reach.any() else 0.0

    def _shown(self, observation: dict[str, Any]) -> dict[str, Any]:
        return {**observation, "coverage": self._before[:1].astype(np.float32)}

    def _with_rewards(self, info: dict[str, Any], terms: Any) -> dict[str, Any]:
        coverage, driven = self._before
        success = np.bool_(coverage >= self._goal and not info["collision"])
        rewards = {"reward_coverage": np.float64(terms[0]), "reward_path": np.float64(terms[1])}
        return {**info, **rewards, "coverage": coverage, "path_length": driven, "is_success": success}


def explore(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    filter: str = "shared-anchor",
    filter_options: Mapping[str, Any] = GAZE_FILTER,
    accuracy: float = 0.8,
    goal: float = 0.6,
    coverage_weight: float = 20.0,
    path_weight: float = 0.01,
) -> gym.Env[Any, Any]:
    """`StereoSlam/Explore-v0`: drive round a block and look about, until the map is worth no further metre.

    The action is `Box(-1, 1, (5,))`: acceleration, steering, stop (above 0.5), pan and tilt. The observation has
    `belief_sigmas` (6,) and `panorama` (12, 6), see `BeliefPanorama`, `head` (2,), `car` (2,), `route` (5, 2),
    `progress` (1,) and `coverage` (1,). The reward is 20 for the whole map (`Coverage`), minus 0.01 for each metre,
    0.05 for each second, and 10 for a collision; nothing is paid for progress along the route. The episode ends with
    the stop, a collision, the end of the route, or after 1200 steps.

    Parameters
    ----------
    render_mode : str, optional
        That of `StereoSlam/DriveGaze-v0`.
    level : {"easy", "normal", "hard"}
        Difficulty, see `LEVELS`.
    arguments : mapping, optional
        Of `StereoSlam/DriveGaze-v0`; JSON-able. The route is "loop" unless given here.
    filter : str
        Name of the filter in the loop.
    filter_options : mapping
        Its options; one that drops what is out of view maps little.
    accuracy, goal, coverage_weight, path_weight : float
        Of `Coverage`.
    """
    unpaid = dict.fromkeys(("progress_weight", "tracking_weight", "goal_weight", "effort_weight"), 0.0)
    own = {"render_mode": render_mode, "route": "loop", **unpaid}
    env = inner_environment("StereoSlam/DriveGaze-v0", level, arguments or {}, **own)
    env = BeliefPanorama(BeliefObservation(env, filter, options=filter_options))
    return SelectedKeys(Coverage(env, accuracy, goal, coverage_weight, path_weight), KEYS)


def explore_by_sweeping(observation: Mapping[str, Any], step: int) -> Action:
    """Action number `step` of a rule: follow the route at 5 m/s, and look left and right in turn, two seconds each."""
    action = drive_slowly(observation, 5)
    action[3] = _PAN if step * FRAME_PERIOD % _PERIOD < 0.5 * _PERIOD else -_PAN
    return action
