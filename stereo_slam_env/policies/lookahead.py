"""`Lookahead`: the direction to turn to, judged by all looks of the next steps of the planned drive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import positive
from stereo_slam_env.policies.imagined_drive import turning_head
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Planner, checked_count, checked_gain, directions


class Lookahead:
    """Turn to where the looks of the next steps, on the planned drive and as fast as the head turns, tell most.

    The head gets there before it is thought again: see `Greedy`.

    Parameters
    ----------
    steps : int
        How far to look ahead, in steps of 0.1 s.
    replan : int
        After how many steps to think again, at the earliest.
    gain : {"pose", "map"}
        What is to be known well: the pose alone, or the pose and the map together.
    pans, tilts : int
        Directions to choose from: a grid over all that the head can do.
    curiosity : float
        What it is worth to look at a place beside the route for the first time, nats.
    effort : float
        What it costs to turn by the largest pan or tilt, nats.
    """

    def __init__(
        self,
        steps: int = 16,
        replan: int = 4,
        gain: str = "pose",
        pans: int = 33,
        tilts: int = 1,
        curiosity: float = 0.15,
        effort: float = 0.05,
    ) -> None:
        self._steps, self._replan = checked_count("steps", steps), checked_count("replan", replan)
        self._gain = checked_gain(gain)
        self._pans, self._tilts = checked_count("pans", pans), checked_count("tilts", tilts)
        self._curiosity = positive("curiosity", curiosity, allow_zero=True)
        self._effort = positive("effort", effort, allow_zero=True)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._gain, self._curiosity, self._effort)
        self._targets = directions(self._planner.outlook.head, self._pans, self._tilts)
        self._target, self._decided = self._planner.outlook.angles, -self._replan

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner = self._planner
        planner.look()
        outlook = planner.outlook
        if planner.step >= self._decided + self._replan and outlook.is_turned_to(self._target):
            angles = turning_head(outlook.head, outlook.angles, self._targets, self._steps)
            self._target, self._decided = planner.best(self._targets, angles), planner.step
        return look_towards(self._env, self._target)
