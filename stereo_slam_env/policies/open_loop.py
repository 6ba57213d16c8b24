"""Open-loop policies, which ignore the observation: baselines for all others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import finite_number, positive
from stereo_slam_env.policies.interface import Action, look_towards, require_head
from stereo_slam_env.world.routes import FRAME_PERIOD


class FixedGaze:
    """Look in one direction, straight ahead by default.

    Parameters
    ----------
    pan, tilt : float
        rad.
    """

    def __init__(self, pan: float = 0.0, tilt: float = 0.0) -> None:
        self._angles = np.array([finite_number("pan", pan), finite_number("tilt", tilt)])

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._action = look_towards(env, self._angles)

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        return self._action


class RandomGaze:
    """Look in a random direction for a while, then in another.

    Parameters
    ----------
    seconds : float
        Duration of each direction.
    """

    def __init__(self, seconds: float = 1.0) -> None:
        self._steps = max(1, round(positive("seconds", seconds) / FRAME_PERIOD))

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._rng, self._step = env, rng, 0
        self._limits = np.array(require_head(env).max_angles)

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        if self._step % self._steps == 0:
            self._action = look_towards(self._env, self._rng.uniform(-self._limits, self._limits))
        self._step += 1
        return self._action


class Sweep:
    """Pan from side to side, in a sine.

    Parameters
    ----------
    period : float
        Duration of one sweep to both sides, s.
    amplitude : float
        Largest pan to either side, rad.
    """

    def __init__(self, period: float = 5.0, amplitude: float = 1.2) -> None:
        self._period, self._amplitude = positive("period", period), positive("amplitude", amplitude)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        require_head(env)
        self._env, self._step = env, 0

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        self._step += 1
        phase = 2 * np.pi * self._step * FRAME_PERIOD / self._period
        return look_towards(self._env, np.array([self._amplitude * np.sin(phase), 0.0]))
