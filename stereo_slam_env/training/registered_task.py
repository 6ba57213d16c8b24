"""A registered environment as a training task: its own reward, and how well a network does in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs.vector_env import RowsVectorEnv
from stereo_slam_env.policies.network import Network
from stereo_slam_env.policies.scores import REFERENCE_RETURNS, normalised_score

_WITH_IDS = ("StereoSlam/Drive-v0", "StereoSlam/Gaze-v0", "StereoSlam/DriveGaze-v0")
"""Environments that show the numbers of landmarks unless they are told not to: of no use to a learner."""


@dataclass(frozen=True)
class EpisodeOutcome:
    """Means over episodes."""

    validation_return: float
    """Sum of the rewards."""
    success: float
    """Share of episodes that end with `is_success`; NaN where the environment does not say."""
    validation_decisions: float
    """Decisions in an episode."""


@dataclass(frozen=True)
class RegisteredTask:
    """An id of this package, with its own reward; JSON-able.

    Raises
    ------
    ValueError
        There is no such id, or it has no native vector.
    """

    environment: str
    """The id."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of `gymnasium.make_vec`."""

    def __post_init__(self) -> None:
        known = sorted(name for name in gym.registry if name.startswith("StereoSlam/"))
        if self.environment not in known:
            raise ValueError(f"environment must be one of {', '.join(known)}, got {self.environment!r}")

    def make_vector(
        self, count: int, *, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, threads: int = 1
    ) -> RowsVectorEnv:
        """So many environments in lock-step."""
        own = {"observe_ids": False} if self.environment in _WITH_IDS else {}
        given = {**own, **self.arguments, "autoreset_mode": autoreset_mode, "threads": threads}
        made: Any = gym.make_vec(self.environment, num_envs=count, **given)
        vector: RowsVectorEnv = made
        return vector

    @property
    def choices(self) -> FloatArray | None:
        """The numbers of a discrete action space, (n, 1); None where the action is a Box."""
        vector = self.make_vector(1)
        space = vector.single_action_space
        vector.close()
        return np.arange(space.n, dtype=np.float64)[:, None] if isinstance(space, spaces.Discrete) else None

    def evaluate(self, network: Network | None, seeds: Sequence[int], threads: int = 1) -> EpisodeOutcome:
        """See `training.evaluate`."""
        vector = self.make_vector(len(seeds), threads=threads)
        actions = np.zeros(vector.action_space.shape or (), dtype=vector.action_space.dtype)
        returns, success, steps = (np.zeros(len(seeds)) for _ in range(3))
        going = np.ones(len(seeds), dtype=np.bool_)
        try:
            observation, info = vector.reset(seed=list(seeds))
            while going.any():
                if network is not None:
                    actions[...] = network.actions(observation).reshape(actions.shape)
                observation, rewards, terminated, truncated, info = vector.step(actions)
                returns, steps = returns + np.where(going, rewards, 0.0), steps + going
                told = info.get("is_success", np.full(len(seeds), np.nan))
                success[going] = np.asarray(told, dtype=np.float64)[going]
                going &= ~(terminated | truncated)
        finally:
            vector.close()
        return EpisodeOutcome(float(returns.mean()), float(success.mean()), float(steps.mean()))

    def words(self, results: EpisodeOutcome) -> str:
        """What a progress bar says of results."""
        said = f"return {results.validation_return:.2f}"
        if np.isfinite(results.success):
            said += f", success {results.success:.0%}"
        if self.environment in REFERENCE_RETURNS and not self.arguments:
            said += f", score {float(normalised_score(self.environment, results.validation_return)):.0f}"
        return said
