"""`PositionPrediction`: the agent says where it is, and is paid for being right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper, Seeds, Step
from stereo_slam_env.wrappers.recorded_wrapper import RowWrapper


class SquaredDistance:
    """Squared Euclidean distance, by NumPy, PyTorch or JAX alike: differentiable where they are."""

    def __call__(self, prediction: Any, target: Any, batch_shape: tuple[int, ...] = (), rng: Any = None) -> Any:
        """The loss of each of a batch, of the type of the arguments; `batch_shape` and `rng` are not used."""
        return ((prediction - target) ** 2).sum(-1)

    numpy = torch = jax = __call__


class PositionPredictionRows(RowsWrapper):
    """What `PositionPrediction` does, on rows; see there."""

    changes = ("_targets", "_losses", "_base")

    def __init__(self, rows: Rows, weight: float, keep_reward: bool) -> None:
        super().__init__(rows)
        self._weight, self._keep_reward = positive("weight", weight), keep_reward
        self.loss_fn = SquaredDistance()
        self.inner_action_space = rows.action_space
        self.prediction_space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
        self.prediction_target_space = self.prediction_space
        self.action_space = spaces.Dict({"action": rows.action_space, "prediction": self.prediction_space})
        self._targets, self._losses, self._base = np.zeros((rows.count, 3)), np.zeros(rows.count), np.zeros(rows.count)

    def begin(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """See `Rows`."""
        self.rows.begin(chosen, seeds, options)
        self._targets[chosen] = self.world.true_positions()[chosen]
        self._losses[chosen] = self._base[chosen] = 0.0

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`; the prediction is judged by where the car was when it was made."""
        self._targets[going] = self.world.true_positions()[going]
        losses = self.loss_fn(np.asarray(actions["prediction"], dtype=np.float64), self._targets)
        rewards, terminated, truncated = self.rows.advance(actions["action"], going)
        self._losses[going] = self._weight * losses[going]
        self._base[going] = rewards[going] if self._keep_reward else 0.0
        return np.where(going, self._base - self._losses, 0.0), terminated, truncated

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`."""
        observation, info = self.rows.look()
        judged = {"target": self._targets.astype(np.float32), "loss": self._losses.copy()}
        return observation, {**info, "prediction": judged, "base_reward": self._base.copy()}


class PositionPrediction(RowWrapper):
    """The agent also predicts where the left camera is, in W, m, and the reward is minus the squared error, m^2.

    The interface is that of Active Perception Gym: the action is a Dict of `action`, that of the environment inside,
    and `prediction` (3,), made from the last observation. `info` gains `prediction` with the `target`, the true
    position at the time of that observation, and the `loss`, and `base_reward`, that of the environment where it is
    kept. Attributes are `loss_fn` (for NumPy, PyTorch and JAX), `prediction_space`, `prediction_target_space` and
    `inner_action_space`. The prediction does not move the car. No filter is needed: an agent may keep a belief of its
    own; one that predicts what a filter estimates earns what `TrueError` pays, a step later.

    Parameters
    ----------
    env : gymnasium.Env
        An environment `StereoSlam/...`, with whatever wrappers inside.
    weight : float
        Of the loss, above 0.
    keep_reward : bool
        Add the reward of the environment.
    """

    OnRows = PositionPredictionRows

    def __init__(self, env: gym.Env[Any, Any], weight: float = 1.0, keep_reward: bool = False) -> None:
        super().__init__(env)

    @property
    def loss_fn(self) -> SquaredDistance:
        """The loss: squared distance."""
        loss: SquaredDistance = self.rows.loss_fn
        return loss

    @property
    def inner_action_space(self) -> gym.Space[Any]:
        """The action of the environment inside."""
        space: gym.Space[Any] = self.rows.inner_action_space
        return space

    @property
    def prediction_space(self) -> spaces.Box:
        """What may be predicted: a position, m."""
        space: spaces.Box = self.rows.prediction_space
        return space

    @property
    def prediction_target_space(self) -> spaces.Box:
        """Where the camera may be, m."""
        space: spaces.Box = self.rows.prediction_target_space
        return space
