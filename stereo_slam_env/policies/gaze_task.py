"""The task of a training, with information gain as the reward, and how well a network does in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from filters.contract.validation import one_of, positive, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.envs.vector_env import RowsVectorEnv, limited
from stereo_slam_env.policies.network import Network
from stereo_slam_env.policies.registry import require_head
from stereo_slam_env.policies.rows import normalised_score, true_figures
from stereo_slam_env.wrappers import (
    BeliefObservation,
    BeliefPanorama,
    DirectionOfGaze,
    InformationGain,
    SelectedKeys,
    TrueError,
)
from stereo_slam_env.wrappers.direction_of_gaze import directions
from stereo_slam_env.wrappers.information import CRITERIA, Criterion
from stereo_slam_env.wrappers.rewards import BeliefOf
from stereo_slam_env.wrappers.vectors import rows_of

GAZE_FILTER: Mapping[str, Any] = {
    "drop_unseen": False,
    "motion": "velocity-driven",
    "iterations": 2,
    "relinearise_above": 1.0,
}
"""Options of a filter for a head that turns: it keeps what is out of view, believes the odometry, and linearises a
second time what its first tangent misses by more than its noise: landmarks that come back into view correct it by a lot
at once, and all others, relinearised, would stretch the way."""
POLICY_KEYS = ("belief_sigmas", "head", "panorama")
"""Keys of the observation that a network decides by, in their order."""
_ID = "StereoSlam/ActiveGaze-v0"
_MEANS = (
    *("final_position_sigma_m", "final_pose_logdet", "position_rmse_m"),
    *("final_position_error_m", "final_position_nees"),
)
Reward = Literal["information", "error"]
"""What is paid for: what a belief gained (`InformationGain`), or the true error after a decision (`TrueError`)."""


@dataclass(frozen=True)
class GazeTask:
    """An environment, the filter in the loop, and the reward; JSON-able."""

    environment: str = "StereoSlam/Gaze-v0"
    """An id with a head."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of the environment."""
    filter: str = "shared-anchor"
    """Name of the filter in the loop."""
    filter_options: Mapping[str, Any] = field(default_factory=lambda: dict(GAZE_FILTER))
    """Of the filter."""
    reward: Reward = "error"
    """For "error" the four arguments of `InformationGain` that follow have no effect."""
    criterion: Criterion = "log-det"
    """Of `InformationGain`, on the pose."""
    belief: BeliefOf = "filter"
    """Of `InformationGain`."""
    nees_gate: float | None = None
    """Of `InformationGain`."""
    resolution: tuple[float, float] = (0.01, 0.001)
    """Of `InformationGain`: knowing the position better than this, m, and the rotation, rad, is worth nothing."""
    hold: int = 5
    """Steps for which a decision holds."""
    pans: int | None = 9
    """Directions to choose from, from the head's farthest left to its farthest right, at no tilt; nothing else is then
    decided. None: the action is that of the environment. Where left and right are as good, a choice can be learnt, and
    the mean of a continuous action ends up between them."""

    def __post_init__(self) -> None:
        one_of("reward", self.reward, get_args(Reward))
        one_of("criterion", self.criterion, CRITERIA)
        one_of("belief", self.belief, get_args(BeliefOf))
        whole_number("hold", self.hold, 1)
        if self.pans is not None:
            whole_number("pans", self.pans, 2)
        object.__setattr__(self, "resolution", tuple(positive("resolution", value) for value in self.resolution))

    def make(self, hold: int = 1) -> gym.Env[Any, Any]:
        """The environment for rules and planners: with the belief in the observation; actions hold for some steps."""
        env = gym.make(self.environment, **self.arguments)
        require_head(env)
        believing: gym.Env[Any, Any] = self._believing(env, hold)
        return believing

    def make_held(self) -> gym.Env[Any, Any]:
        """The environment for networks: `POLICY_KEYS` alone, decisions hold, the reward is that of the task."""
        held: gym.Env[Any, Any] = self._held(gym.make(self.environment, **self.arguments))
        return held

    def make_for_learning(self) -> gym.Env[Any, Any]:
        """`make_held`, with the number of one of `choices` for an action if there are any."""
        env = self.make_held()
        return env if self.pans is None else DirectionOfGaze(env, self.pans)

    def make_rows(self, num_envs: int, scenes: int | None = None, threads: int = 1) -> Rows:
        """So many times `make_for_learning` as rows; see `wrappers.vectors.stereo_vector`."""
        given = dict(self.arguments)
        limit = given.pop("max_episode_steps", gym.spec(self.environment).max_episode_steps)
        given.pop("disable_env_checker", None)
        rows = rows_of(self.environment, num_envs, given, scenes=scenes, threads=threads)
        held = self._held(limited(rows, limit))
        made: Rows = held if self.pans is None else DirectionOfGaze.around(held, pans=self.pans)
        return made

    def make_vector(
        self,
        count: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        scenes: int | None = None,
        threads: int = 1,
    ) -> RowsVectorEnv:
        """`make_rows` as a vector of Gymnasium."""
        return RowsVectorEnv(self.make_rows(count, scenes, threads), autoreset_mode)

    def _believing(self, inside: gym.Env[Any, Any] | Rows, hold: int) -> Any:
        believing = BeliefObservation.around(inside, filter=self.filter, options=self.filter_options, hold=hold)
        return BeliefPanorama.around(believing)

    def _held(self, inside: gym.Env[Any, Any] | Rows) -> Any:
        believing = self._believing(inside, self.hold)
        if self.reward == "error":
            paid = TrueError.around(believing)
        else:
            paid = InformationGain.around(
                believing,
                criterion=self.criterion,
                of="pose",
                resolution=self.resolution,
                belief=self.belief,
                nees_gate=self.nees_gate,
            )
        return SelectedKeys.around(paid, keys=POLICY_KEYS)

    @property
    def training(self) -> Mapping[str, Any]:
        """Settings that the task states: the defaults of `PPOSettings` are its own."""
        return {}

    @property
    def choices(self) -> FloatArray | None:
        """Pan and tilt to choose from, as shares of the largest; (pans, 2)."""
        return None if self.pans is None else directions(self.pans)

    def evaluate(self, network: Network | None, seeds: Sequence[int], threads: int = 1) -> PolicyEvaluation:
        """See `evaluate`; without a network the head looks straight ahead."""
        vector = replace(self, pans=None).make_vector(len(seeds), threads=threads)
        actions = np.zeros(vector.action_space.shape or (), dtype=np.float32)

        def act(observation: Any, going: BoolArray) -> Any:
            if network is not None:
                actions[:, -2:] = network.actions(observation)
            return actions

        try:
            figures = true_figures(vector, lambda _: act, seeds)
        finally:
            vector.close()
        means = {name: float(getattr(figures, name).mean()) for name in _MEANS}
        return PolicyEvaluation(**means, validation_return=float(figures.returns.mean()))

    def words(self, results: PolicyEvaluation) -> str:
        """What a progress bar says of results; the score is that of the id, with its own arguments."""
        said = f"true error {results.final_position_error_m:.3f} m, claimed {results.final_position_sigma_m:.3f} m"
        if self != GazeTask():
            return said
        return f"{said}, score {float(normalised_score(_ID, results.validation_return)):.0f}"


@dataclass(frozen=True)
class PolicyEvaluation:
    """Means over episodes."""

    final_position_sigma_m: float
    """Root of the trace of the position covariance at the end."""
    final_pose_logdet: float
    """Natural logarithm of the determinant of the pose covariance at the end (m, rad)."""
    position_rmse_m: float
    """Root mean square of the true position error over each episode."""
    final_position_error_m: float
    """True position error at the end."""
    final_position_nees: float
    """NEES of the position at the end, over its 3 degrees of freedom: more than 1 is claimed than is true."""
    validation_return: float = float("nan")
    """Sum of the rewards."""


def evaluate(network: Network | None, task: Any, seeds: Sequence[int], *, threads: int = 1) -> Any:
    """Means over an episode for each seed, all in lock-step; without a network the action is 0: straight ahead.

    `task` is a `GazeTask`, whose means are an `Evaluation`, or a `RegisteredTask`, whose means are an `Outcome`.
    """
    return task.evaluate(network, seeds, threads)
