"""`Greedy`: the direction from which one look is expected to tell most."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from stereo_slam_env.policies.expected_gain import Gain
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Planner, Preferences


class Greedy:
    """Look where one look is expected to tell most, as if the head were there at once; get there, and choose again.

    Choosing again on the way would leave the head between two groups that are worth about the same.

    Parameters
    ----------
    gain, pans, tilts, curiosity, effort
        See `Preferences`.
    """

    def __init__(
        self, gain: Gain = "map", pans: int = 17, tilts: int = 1, curiosity: float = 0.15, effort: float = 0.05
    ) -> None:
        self._preferences = Preferences(gain, pans, tilts, curiosity, effort)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._preferences)
        self._target = self._planner.outlook.angles

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner = self._planner
        planner.look()
        if planner.outlook.is_turned_to(self._target):
            self._target = planner.best(planner.targets[:, None])
        return look_towards(self._env, self._target)
