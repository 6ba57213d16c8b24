"""`Greedy`: the direction from which one look is expected to tell most."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import positive
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Planner, checked_count, checked_gain, directions


class Greedy:
    """Look where one look is expected to tell most, as if the head were there at once; get there, and choose again.

    Choosing again on the way would leave the head between two groups that are worth about the same.

    Parameters
    ----------
    gain : {"map", "pose"}
        What is to be known well: the pose and the map together, or the pose alone.
    pans, tilts : int
        Directions to choose from: a grid over all that the head can do.
    curiosity : float
        What it is worth to look at a place beside the route for the first time, nats.
    effort : float
        What it costs to turn by the largest pan or tilt, nats.
    """

    def __init__(
        self, gain: str = "map", pans: int = 17, tilts: int = 1, curiosity: float = 0.15, effort: float = 0.05
    ) -> None:
        self._gain = checked_gain(gain)
        self._pans, self._tilts = checked_count("pans", pans), checked_count("tilts", tilts)
        self._curiosity = positive("curiosity", curiosity, allow_zero=True)
        self._effort = positive("effort", effort, allow_zero=True)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._gain, self._curiosity, self._effort)
        self._targets = directions(self._planner.outlook.head, self._pans, self._tilts)
        self._target = self._planner.outlook.angles

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner, targets = self._planner, self._targets
        planner.look()
        if planner.outlook.is_turned_to(self._target):
            self._target = planner.best(targets, targets[:, None])
        return look_towards(self._env, self._target)
