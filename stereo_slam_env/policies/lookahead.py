"""`Lookahead`: the direction to turn to, judged by all looks of the next steps of the planned drive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from stereo_slam_env.policies.expected_gain import Gain
from stereo_slam_env.policies.imagined_drive import turning_head
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Planner, Preferences, checked_count


class Lookahead:
    """Turn to where the looks of the next steps, on the planned drive and as fast as the head turns, tell most.

    The head gets there before it is thought again: see `Greedy`.

    Parameters
    ----------
    steps : int
        How far to look ahead, in steps of 0.1 s.
    replan : int
        After how many steps to think again, at the earliest.
    gain, pans, tilts, curiosity, effort
        See `Preferences`.
    """

    def __init__(
        self,
        steps: int = 16,
        replan: int = 4,
        gain: Gain = "pose",
        pans: int = 33,
        tilts: int = 1,
        curiosity: float = 0.15,
        effort: float = 0.05,
    ) -> None:
        self._steps, self._replan = checked_count("steps", steps), checked_count("replan", replan)
        self._preferences = Preferences(gain, pans, tilts, curiosity, effort)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._preferences)
        self._target, self._decided = self._planner.outlook.angles, -self._replan

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner = self._planner
        planner.look()
        outlook = planner.outlook
        if planner.step >= self._decided + self._replan and outlook.is_turned_to(self._target):
            angles = turning_head(outlook.head, outlook.angles, planner.targets, self._steps)
            self._target, self._decided = planner.best(angles), planner.step
        return look_towards(self._env, self._target)
