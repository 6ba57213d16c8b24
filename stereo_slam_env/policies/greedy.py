"""`Greedy`: the direction from which one look is expected to tell most."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import positive
from stereo_slam_env.policies.imagined_drive import turning_head
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Planner, checked_count, checked_gain, directions


class Greedy:
    """Look where one look, a step from now, is expected to tell most, as if the head were there at once.

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
    at_once : bool
        False: look from where the head gets in one step. That makes it blind to all that is farther away.
    """

    def __init__(
        self,
        gain: str = "map",
        pans: int = 17,
        tilts: int = 1,
        curiosity: float = 0.05,
        effort: float = 0.05,
        at_once: bool = True,
    ) -> None:
        self._gain = checked_gain(gain)
        self._pans, self._tilts = checked_count("pans", pans), checked_count("tilts", tilts)
        self._curiosity = positive("curiosity", curiosity, allow_zero=True)
        self._effort = positive("effort", effort, allow_zero=True)
        self._at_once = at_once

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._gain, self._curiosity, self._effort)
        self._targets = directions(self._planner.outlook.head, self._pans, self._tilts)

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner, targets = self._planner, self._targets
        planner.look()
        angles = targets[:, None]
        if not self._at_once:
            angles = turning_head(planner.outlook.head, planner.outlook.angles, targets, 1)
        return look_towards(self._env, planner.best(targets, angles))
