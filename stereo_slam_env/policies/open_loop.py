"""Open-loop policies, which ignore the observation: baselines for all others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.contract.validation import finite_number, positive
from filters.geometry.arrays import FloatArray
from stereo_slam_env.policies.registry import Action, look_towards, require_head
from stereo_slam_env.world.routes import FRAME_PERIOD


class _OpenLoop:
    """Looks where `_angles` says after each number of steps."""

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._limits = np.array(require_head(env).max_angles)
        self._env, self._rng, self._step = env, rng, -1

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        self._step += 1
        return look_towards(self._env, self._angles())

    def _angles(self) -> FloatArray:
        raise NotImplementedError


class FixedGaze(_OpenLoop):
    """Look in one direction, straight ahead by default.

    Parameters
    ----------
    pan, tilt : float
        rad.
    """

    def __init__(self, pan: float = 0.0, tilt: float = 0.0) -> None:
        self._direction = np.array([finite_number("pan", pan), finite_number("tilt", tilt)])

    def _angles(self) -> FloatArray:
        return self._direction


class RandomGaze(_OpenLoop):
    """Look in a random direction for a while, then in another.

    Parameters
    ----------
    seconds : float
        Duration of each direction.
    """

    def __init__(self, seconds: float = 1.0) -> None:
        self._steps = max(1, round(positive("seconds", seconds) / FRAME_PERIOD))

    def _angles(self) -> FloatArray:
        if self._step % self._steps == 0:
            self._direction: FloatArray = self._rng.uniform(-self._limits, self._limits)
        return self._direction


class Sweep(_OpenLoop):
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

    def _angles(self) -> FloatArray:
        phase = 2 * np.pi * (self._step + 1) * FRAME_PERIOD / self._period
        return np.array([self._amplitude * np.sin(phase), 0.0])
