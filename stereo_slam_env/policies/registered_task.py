"""Training tasks: any registered environment with its own reward, PPO settings, and the evaluation of a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from filters.contract.validation import positive, probability, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.envs.vector_env import RowsVectorEnv
from stereo_slam_env.policies.named_policies import Network
from stereo_slam_env.policies.policy_rows import REFERENCE_RETURNS, normalised_score, true_figures

_STEERING: Mapping[str, Any] = {
    **{"environments": 64, "rollout": 4096, "minibatch": 512, "evaluate_every": 65_536, "validation": 32},
    **{"learning_rate": 1e-3, "discount": 0.995, "entropy": 0.002},
    **{"initial_log_std": -1.2, "initial_bias": [0.3, 0.0]},
}
"""Steering: a car that drives, and hardly swerves, from the beginning. One that stands, or leaves the lane at once,
sees no road."""
_FEW_DECISIONS: Mapping[str, Any] = {"rollout": 512, "minibatch": 64, "validation": 32}
"""Tasks in which a decision takes a second of driving or more."""
TRAINING: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "Drive": {**_STEERING, "decisions": 262_144, "arguments": {"keys": ["car", "progress", "route"]}},
        "ClosedLoop": {**_STEERING, "decisions": 393_216},
        "Branches": {**_FEW_DECISIONS, "decisions": 8_192, "evaluate_every": 4_096},
        # A car that does not keep its lane yet would learn to stop at once, and so does one that often stops by chance.
        "Explore": {
            **_FEW_DECISIONS,
            **{"arguments": {"choices": {}}, "decisions": 24_576, "evaluate_every": 12_288},
            "initial_bias": [-2.0, *[0.0] * 6],
        },
        # Whoever stops every other time never sees a loop closed. Most of the time is the way to the first decision,
        # and the more environments there are, the more drive it together.
        "Revisit": {
            **{"decisions": 20_480, "environments": 64, "minibatch": 512, "epochs": 5, "entropy": 0.03},
            **{"gae_lambda": 1.0, "discount": 1.0, "initial_bias": [-3.5, 0.0]},
            **{"evaluate_every": 10_240, "validation": 32},
        },
    }
)
"""Settings with which the ids of this package, at any level, are best learnt, and `arguments` to make them with."""
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
        There is no such id, or its observation is no Dict of Boxes, or its action neither a Box nor Discrete.
    """

    environment: str
    """The id; whoever registers one of another package has imported that."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of `gymnasium.make_vec`, over those that the environment states."""

    def __post_init__(self) -> None:
        if self.environment not in gym.registry:
            ids = sorted(name for name in gym.registry if name.startswith("StereoSlam/"))
            raise ValueError(f"environment must be one of {', '.join(ids)}, or registered, got {self.environment!r}")
        object.__setattr__(self, "arguments", {**self._stated.get("arguments", {}), **self.arguments})

    @cached_property
    def _stated(self) -> Mapping[str, Any]:
        """Content of `metadata["training"]`, or for an id of this package its entry of `TRAINING`."""
        vector = _vector(self.environment, 1, {}, AutoresetMode.NEXT_STEP, 1)
        vector.close()
        seen, done = vector.single_observation_space, vector.single_action_space
        if not isinstance(seen, spaces.Dict) or not all(isinstance(part, spaces.Box) for part in seen.values()):
            raise ValueError(f"environment must show a Dict of Boxes, {self.environment!r} shows {seen}: wrap it")
        if not isinstance(done, (spaces.Box, spaces.Discrete)):
            raise ValueError(
                f"environment must take a Box or Discrete as its action, {self.environment!r} takes {done}"
            )
        name = self.environment.removeprefix("StereoSlam/").split("-")[0]
        own = TRAINING.get(name, {}) if self.environment.startswith("StereoSlam/") else {}
        stated: Mapping[str, Any] = vector.metadata.get("training", own)
        return stated

    @property
    def training(self) -> Mapping[str, Any]:
        """Settings that the environment states; what counts is the return, so what comes later counts nearly as much.

        At 0.99, standing still, which costs 0.04 a step, is better than an accident now, which costs 10: a car that
        cannot drive yet learns to stand.
        """
        return {"discount": 0.999, **{name: value for name, value in self._stated.items() if name != "arguments"}}

    def make_vector(
        self,
        count: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        scenes: int | None = None,
        threads: int = 1,
    ) -> gym.vector.VectorEnv[Any, Any, Any]:
        """So many environments in lock-step; of this package with a pool of `scenes`."""
        return _vector(self.environment, count, self.arguments, AutoresetMode(autoreset_mode), threads, scenes)

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
        vector = self.make_vector(len(seeds), threads=threads)
        actions = np.zeros(vector.action_space.shape or (), dtype=vector.action_space.dtype)
        returns, success, steps = (np.zeros(len(seeds)) for _ in range(3))
        active = np.ones(len(seeds), dtype=np.bool_)
        try:
            observation, info = vector.reset(seed=list(seeds))  # type: ignore[arg-type]
            while active.any():
                if network is not None:
                    actions[...] = network.actions(observation).reshape(actions.shape)
                if isinstance(vector, RowsVectorEnv):  # whose episodes are over wait
                    observation, rewards, terminated, truncated, info = vector.advance(actions, active)
                else:
                    observation, rewards, terminated, truncated, info = vector.step(actions)
                returns, steps = returns + np.where(active, rewards, 0.0), steps + active
                told = info.get("is_success", np.full(len(seeds), np.nan))
                success[active] = np.asarray(told, dtype=np.float64)[active]
                active &= ~(terminated | truncated)
        finally:
            vector.close()
        return EpisodeOutcome(float(returns.mean()), float(success.mean()), float(steps.mean()))

    def words(self, results: EpisodeOutcome) -> str:
        """Text of a progress bar on results."""
        said = f"return {results.validation_return:.2f}"
        if np.isfinite(results.success):
            said += f", success {results.success:.0%}"
        if self.is_scored:
            said += f", score {float(normalised_score(self.environment, results.validation_return)):.0f}"
        return said


def _vector(
    environment: str,
    count: int,
    arguments: Mapping[str, Any],
    mode: AutoresetMode,
    threads: int,
    scenes: int | None = None,
) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Many environments with an id: its native vector, or one after the other."""
    entry = gym.spec(environment.rpartition(":")[2]).vector_entry_point
    if not str(entry).startswith("stereo_slam_env."):  # other people's vectors have other arguments
        how: dict[str, Any] = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}}
    else:
        own_arguments = {"observe_ids": False} if environment in _WITH_IDS else {}
        spread = {"threads": threads} if threads > 1 else {}
        how = {**own_arguments, "autoreset_mode": mode, "scenes": scenes, **spread}
    environments: gym.vector.VectorEnv[Any, Any, Any] = gym.make_vec(
        environment, num_envs=count, **{**how, **arguments}
    )
    return environments


VALIDATION_SEEDS = tuple(range(100_000, 100_256))
"""Episodes on which the best network of a run is chosen; training never sees them, and reports use others."""


@dataclass(frozen=True)
class PPOSettings:
    """Settings of the training.

    Raises
    ------
    ValueError
        A value is impossible.
    """

    decisions: int = 120_000
    """How many are made in all; in a `GazeTask` each holds for `hold` steps."""
    seed: int = 0
    """Of the network, of chance in its actions, and of the episodes."""
    environments: int = 16
    """How many run at once, in lock-step."""
    threads: int = 1
    """Over which the environments are spread; the result does not depend on it."""
    scenes: int | None = 64
    """Size of the pool that the scenes of training episodes come from, each for ten episodes; None: a new one each."""
    layers: tuple[int, ...] = (64, 64)
    """Neurons of the hidden layers, of policy and value alike."""
    rollout: int = 2048
    """Decisions of all environments together between two updates."""
    minibatch: int = 256
    """Decisions in a gradient step."""
    epochs: int = 10
    """Passes over a rollout."""
    learning_rate: float = 5e-4
    """Step size of Adam."""
    discount: float = 0.95
    """Weight of a reward that comes one decision later."""
    gae_lambda: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """By how much the ratio of new to old probability of a decision may differ from 1."""
    entropy: float = 0.01
    """Weight of the entropy of decisions, so that it goes on trying."""
    initial_log_std: float = -0.7
    """Logarithm of the standard deviation of continuous actions at first."""
    initial_bias: tuple[float, ...] = ()
    """Of the outputs of the policy at first: logits of a choice, or means of the entries of a Box; none: 0."""
    evaluate_every: int = 16_384
    """Decisions between two looks at the validation episodes."""
    validation: int = len(VALIDATION_SEEDS)
    """How many of these there are, at most 256."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        object.__setattr__(self, "initial_bias", tuple(self.initial_bias))
        for name in ("decisions", "environments", "threads", "rollout", "minibatch", "epochs", "evaluate_every"):
            whole_number(name, getattr(self, name), 1)
        if self.scenes is not None:
            whole_number("scenes", self.scenes, 1)
        whole_number("validation", self.validation, 1, len(VALIDATION_SEEDS))
        whole_number("seed", self.seed, 0)
        for width in self.layers:
            whole_number("layers", width, 1)
        for name in ("learning_rate", "clip"):
            positive(name, getattr(self, name))
        positive("entropy", self.entropy, allow_zero=True)
        for name in ("discount", "gae_lambda"):
            probability(name, getattr(self, name))

    @property
    def steps(self) -> int:
        """Decisions of each environment between two updates."""
        return max(self.rollout // self.environments, 1)


_ID = "StereoSlam/ActiveGaze-v0"
_MEANS = (
    *("final_position_sigma_m", "final_pose_logdet", "position_rmse_m"),
    *("final_position_error_m", "final_position_nees"),
)


_SIZES = ("final_position_sigma_m", "position_rmse_m", "final_position_error_m", "final_position_nees")


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


def evaluate(
    network: Network | None, task: GazeTask | RegisteredTask, seeds: Sequence[int], *, threads: int = 1
) -> Any:
    """Means over an episode for each seed, all in lock-step; without a network the action is 0: straight ahead.

    Those of a `GazeTask` are a `PolicyEvaluation`, in several worlds the geometric means of errors and arithmetic ones
    of the others, with the seeds spread over them; those of a `RegisteredTask` are an `EpisodeOutcome`.
    """
    if not isinstance(task, GazeTask):
        return task.evaluate(network, seeds, threads)
    worlds = task.each_world
    each = [_looks(network, world, seeds[k :: len(worlds)], threads) for k, world in enumerate(worlds)]
    combined = {}
    for name in (*_MEANS, "validation_return"):
        values = np.array([getattr(figures, name) for figures in each])
        combined[name] = float(np.exp(np.log(values).mean()) if name in _SIZES else values.mean())
    return PolicyEvaluation(**combined)


def _looks(network: Network | None, task: GazeTask, seeds: Sequence[int], threads: int) -> PolicyEvaluation:
    """Means over the episodes in one world."""
    vector = replace(task, pans=None).make_vector(len(seeds), threads=threads)
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


def words(task: GazeTask | RegisteredTask, results: Any) -> str:
    """Results in the words of a progress bar; the score is that of the id, with its own arguments."""
    if not isinstance(task, GazeTask):
        return task.words(results)
    errors = f"true error {results.final_position_error_m:.3f} m, claimed {results.final_position_sigma_m:.3f} m"
    if task != GazeTask():
        return errors
    return f"{errors}, score {float(normalised_score(_ID, results.validation_return)):.0f}"
