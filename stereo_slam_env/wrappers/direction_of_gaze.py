"""`DirectionOfGaze`: the action is the number of a direction to look in."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.contract.validation import whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Rows, RowsWrapper, Step
from stereo_slam_env.world.vehicle import Head
from stereo_slam_env.wrappers.row_wrapper import RowWrapper


class DirectionOfGazeRows(RowsWrapper):
    """What `DirectionOfGaze` does, on rows."""

    def __init__(self, rows: Rows, pans: int) -> None:
        super().__init__(rows)
        looks = directions(whole_number("pans", pans, 2))
        moving_head(self.needed("head"))
        size = rows.action_space.shape[0]
        self._actions = np.concatenate([np.zeros((pans, size - 2)), looks], axis=1).astype(np.float32)
        self.action_space = spaces.Discrete(pans)

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`."""
        return self.rows.advance(self._actions[np.asarray(actions)], going)


class DirectionOfGaze(RowWrapper):
    """The action is the number of a direction to look in, from the farthest left to the farthest right.

    Parameters
    ----------
    env : gymnasium.Env
        With a head.
    pans : int
        Number of directions.
    """

    OnRows = DirectionOfGazeRows

    def __init__(self, env: gym.Env[Any, Any], pans: int = 9) -> None:
        super().__init__(env)


def moving_head(head: Any) -> Head:
    """The head of an environment; a `ValueError` where it has none that moves."""
    if not isinstance(head, Head):
        raise ValueError("the policy turns the head, and that of this environment is fixed: use StereoSlam/Gaze-v0")
    return head


def directions(pans: int) -> FloatArray:
    """Pan and tilt as shares of the largest: from left to right, at no tilt; (pans, 2)."""
    return np.column_stack([np.linspace(-1.0, 1.0, pans), np.zeros(pans)])
