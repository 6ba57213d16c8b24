"""The task of a training, with information gain as the reward, and how well a network does in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FilterObservation, RepeatAction, TransformAction
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from filters.validation import FloatArray, positive, whole_number
from stereo_slam_env.policies.interface import gaze_action, require_head
from stereo_slam_env.policies.network import Network
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, InformationGain
from stereo_slam_env.wrappers.information import Criterion

GAZE_FILTER: Mapping[str, Any] = {"drop_unseen": False, "motion": "velocity-driven", "iterations": 2}
"""Options of a filter for a head that turns: it keeps what is out of view, believes the odometry, and linearises twice,
because landmarks that come back into view correct it by a lot at once."""
POLICY_KEYS = ("belief_sigmas", "head", "panorama")
"""Keys of the observation that a network decides by, in their order."""


@dataclass(frozen=True)
class GazeTask:
    """An environment, the filter in the loop, and the reward; JSON-able.

    Attributes
    ----------
    environment : str
        An id with a head.
    arguments : mapping
        Of the environment.
    filter : str
        Name of the filter in the loop.
    filter_options : mapping
        Of the filter.
    criterion : {"log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"}
        Of `InformationGain`, on the pose.
    resolution : (2,) tuple
        Of `InformationGain`: knowing the position better than this, m, and the rotation, rad, is worth nothing.
    hold : int
        Steps for which a decision holds.
    pans : int, optional
        Directions to choose from, from the head's farthest left to its farthest right, at no tilt; nothing else is then
        decided. None: the action is that of the environment. Where left and right are as good, a choice can be learnt,
        and the mean of a continuous action ends up between them.
    """

    environment: str = "StereoSlam/Gaze-v0"
    arguments: Mapping[str, Any] = field(default_factory=dict)
    filter: str = "shared-anchor"
    filter_options: Mapping[str, Any] = field(default_factory=lambda: dict(GAZE_FILTER))
    criterion: Criterion = "log-det"
    resolution: tuple[float, float] = (0.01, 0.001)
    hold: int = 5
    pans: int | None = 9

    def __post_init__(self) -> None:
        whole_number("hold", self.hold, 1)
        if self.pans is not None:
            whole_number("pans", self.pans, 2)
        object.__setattr__(self, "resolution", tuple(positive("resolution", value) for value in self.resolution))

    def make(self) -> gym.Env[Any, Any]:
        """The environment for rules and planners: with the belief in the observation."""
        env = gym.make(self.environment, **self.arguments)
        require_head(env)
        return BeliefPanorama(BeliefObservation(env, self.filter, options=self.filter_options))

    def make_held(self) -> gym.Env[Any, Any]:
        """The environment for networks: `POLICY_KEYS` alone, decisions hold, the reward is information on the pose."""
        paid = InformationGain(self.make(), self.criterion, of="pose", resolution=self.resolution)
        return FilterObservation(RepeatAction(paid, self.hold), POLICY_KEYS)

    def make_for_learning(self) -> gym.Env[Any, Any]:
        """`make_held`, with the number of one of `choices` for an action if there are any."""
        env = self.make_held()
        choices = self.choices
        if choices is None:
            return env
        actions = [gaze_action(env, choice) for choice in choices]
        return TransformAction(env, lambda number: actions[number], spaces.Discrete(len(actions)))

    @property
    def choices(self) -> FloatArray | None:
        """Pan and tilt to choose from, as shares of the largest; (pans, 2)."""
        if self.pans is None:
            return None
        return np.column_stack([np.linspace(-1.0, 1.0, self.pans), np.zeros(self.pans)])


@dataclass(frozen=True)
class Evaluation:
    """Means over episodes.

    Attributes
    ----------
    final_position_sigma_m : float
        Root of the trace of the position covariance at the end.
    final_pose_logdet : float
        Natural logarithm of the determinant of the pose covariance at the end (m, rad).
    position_rmse_m : float
        Root mean square of the true position error over each episode.
    final_position_error_m : float
        True position error at the end.
    """

    final_position_sigma_m: float
    final_pose_logdet: float
    position_rmse_m: float
    final_position_error_m: float


def evaluate(network: Network | None, task: GazeTask, seeds: Sequence[int], *, processes: int = 1) -> Evaluation:
    """Run an episode for each seed; without a network the head looks straight ahead."""
    with threadpool_limits(1):
        rows = Parallel(processes)(delayed(_figures)(network, task, seed) for seed in seeds)
    return Evaluation(*(float(value) for value in np.mean(rows, axis=0)))


def _figures(network: Network | None, task: GazeTask, seed: int) -> list[float]:
    """The figures of `Evaluation`, of one episode."""
    env = task.make_held()
    try:
        observation, info = env.reset(seed=seed)
        slam = env.get_wrapper_attr("slam")
        errors, over = [], False
        while not over:
            action = gaze_action(env, np.zeros(2) if network is None else network.action(observation))
            observation, _, terminated, truncated, info = env.step(action)
            errors.append(float(np.linalg.norm(slam.pose.position - info["truth_position"])))
            over = terminated or truncated
    finally:
        env.close()
    P = slam.pose.covariance
    rmse = float(np.sqrt(np.mean(np.square(errors))))
    return [float(np.sqrt(np.trace(P[:3, :3]))), float(np.linalg.slogdet(P)[1]), rmse, errors[-1]]
