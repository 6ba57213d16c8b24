"""A registered environment as a training task: its own reward, and how well a network does in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
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
    """An id of Gymnasium, with its own reward; JSON-able.

    Environments may state how they are best learnt: `metadata["training"]` has settings of `PPOSettings` by name, and
    `arguments` with which they are made for that.

    Raises
    ------
    ValueError
        There is no such id.
    """

    environment: str
    """The id; whoever registers one of another package has imported that."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of `gymnasium.make_vec`, over those that the environment states."""

    def __post_init__(self) -> None:
        if self.environment not in gym.registry:
            known = sorted(name for name in gym.registry if name.startswith("StereoSlam/"))
            raise ValueError(f"environment must be one of {', '.join(known)}, or registered, got {self.environment!r}")
        object.__setattr__(self, "arguments", {**self._stated.get("arguments", {}), **self.arguments})

    @cached_property
    def _stated(self) -> Mapping[str, Any]:
        """What `metadata["training"]` has."""
        vector = _vector(self.environment, 1, {}, AutoresetMode.NEXT_STEP, 1)
        vector.close()
        stated: Mapping[str, Any] = vector.metadata.get("training", {})
        return stated

    @property
    def training(self) -> Mapping[str, Any]:
        """Settings that the environment states; what counts is the return, so what comes later counts nearly as much.

        At 0.99, standing still, which costs 0.04 a step, is better than an accident now, which costs 10: a car that
        cannot drive yet learns to stand.
        """
        return {"discount": 0.999, **{name: value for name, value in self._stated.items() if name != "arguments"}}

    def make_vector(
        self, count: int, *, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, threads: int = 1
    ) -> gym.vector.VectorEnv[Any, Any, Any]:
        """So many environments in lock-step."""
        return _vector(self.environment, count, self.arguments, AutoresetMode(autoreset_mode), threads)

    @property
    def choices(self) -> FloatArray | None:
        """The numbers of a discrete action space, (n, 1); None where the action is a Box."""
        vector = self.make_vector(1)
        space = vector.single_action_space
        vector.close()
        return np.arange(space.n, dtype=np.float64)[:, None] if isinstance(space, spaces.Discrete) else None

    @property
    def is_scored(self) -> bool:
        """Whether its returns have a score: those of an id that has one, with the arguments that it states."""
        return self.environment in REFERENCE_RETURNS and self.arguments == self._stated.get("arguments", {})

    def evaluate(self, network: Network | None, seeds: Sequence[int], threads: int = 1) -> EpisodeOutcome:
        """See `training.evaluate`."""
        vector = self.make_vector(len(seeds), threads=threads)
        actions = np.zeros(vector.action_space.shape or (), dtype=vector.action_space.dtype)
        returns, success, steps = (np.zeros(len(seeds)) for _ in range(3))
        going = np.ones(len(seeds), dtype=np.bool_)
        try:
            observation, info = vector.reset(seed=list(seeds))  # type: ignore[arg-type]
            while going.any():
                if network is not None:
                    actions[...] = network.actions(observation).reshape(actions.shape)
                if isinstance(vector, RowsVectorEnv):  # whose episodes are over wait
                    observation, rewards, terminated, truncated, info = vector.advance(actions, going)
                else:
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
        if self.is_scored:
            said += f", score {float(normalised_score(self.environment, results.validation_return)):.0f}"
        return said


def _vector(
    environment: str, count: int, arguments: Mapping[str, Any], mode: AutoresetMode, threads: int
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Many environments with an id: its native vector, or one after the other."""
    if gym.spec(environment.rpartition(":")[2]).vector_entry_point is None:
        how: dict[str, Any] = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    else:
        own = {"observe_ids": False} if environment in _WITH_IDS else {}
        how = {**own, "autoreset_mode": mode, **({"threads": threads} if threads > 1 else {})}
    made: gym.vector.VectorEnv[Any, Any, Any] = gym.make_vec(environment, num_envs=count, **{**how, **arguments})
    return made
