"""`TrueError`: the reward is the true error of the filter's position."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.contract.validation import finite_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper, Seeds, Step
from stereo_slam_env.wrappers.filter_rows import FilterRows
from stereo_slam_env.wrappers.recorded_wrapper import RowWrapper


class TrueErrorRows(RowsWrapper):
    """What `TrueError` does, on rows; see there."""

    changes = ("_squares",)

    def __init__(self, rows: Rows, weight: float, keep_reward: bool) -> None:
        super().__init__(rows)
        self._beliefs: FilterRows = self.needed("beliefs")
        self._weight, self._keep_reward = finite_number("weight", weight), keep_reward
        self._squares = np.zeros(rows.count)

    def begin(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """See `Rows`."""
        self.rows.begin(chosen, seeds, options)
        self._squares = np.where(chosen, self._now(), self._squares)

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`; the reward is the error after the step."""
        rewards, terminated, truncated = self.rows.advance(actions, going)
        self._squares = np.where(going, self._now(), self._squares)
        paid = np.where(going, -self._weight * self._squares, 0.0)
        return rewards + paid if self._keep_reward else paid, terminated, truncated

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`."""
        observation, info = self.rows.look()
        return observation, {**info, "reward_error": -self._weight * self._squares}

    def _now(self) -> FloatArray:
        """Squared errors of all rows, m^2; (B,)."""
        errors = self._beliefs.poses[:, :3] - self.world.true_positions()
        return np.asarray(np.einsum("bi,bi->b", errors, errors))


class TrueError(RowWrapper):
    """The reward of a step is minus the squared true error of the filter's position, m^2.

    A filter cannot earn by claiming more than it knows, as it can by `InformationGain`. The reward needs the truth,
    which every simulator has: the observation does not contain it, and a policy that was trained on it runs without.

    `info` gains `reward_error`, at reset that of the start.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside.
    weight : float
        Of the reward.
    keep_reward : bool
        Add it to the reward of the environment, instead of replacing that.

    Raises
    ------
    ValueError
        There is no filter in the loop, or the weight is not finite.
    """

    OnRows = TrueErrorRows

    def __init__(self, env: gym.Env[Any, Any], weight: float = 1.0, keep_reward: bool = False) -> None:
        super().__init__(env)
