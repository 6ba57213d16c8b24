"""`FlattenUVD`: one row of numbers between -1 and 1, for any policy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.validation import FloatArray
from stereo_slam_env.wrappers.padded_rows import MASK_OF
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space

UNITS: Mapping[str, float] = MappingProxyType(
    {
        "belief_position": 1.0,
        "belief_landmarks": 1.0,
        "belief_covariance": 1e-6,
        "belief_landmark_covariances": 1e-4,
        "belief_sigmas": 1e-3,
    }
)
"""Keys over many orders of magnitude, and where their logarithmic scale becomes linear (in their own units)."""


class FlattenUVD(RecordedWrapper):
    """The Dict observation as one 1-D float32 Box in [-1, 1].

    In the order of the Dict's keys, each raveled; `layout` says which entries are whose:

    - Boxes of floats (`uvd`, `odometry`, `head`, `panorama`, ...), linearly: -1 and 1 are the bounds;
    - positions, covariances and sigmas of the belief, which spread over orders of magnitude: sign(x)
      log(1 + |x| / s) / log(1 + b / s), with b the bound and s the unit of `UNITS`;
    - masks as 0 and 1. Rows that they do not count are 0;
    - what is integer (ids, which are names and no numbers, and images) is left out.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation of bounded Boxes and MultiBinary masks.

    Raises
    ------
    ValueError
        The observation is no Dict, or a Box in it is not bounded.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        parts: list[_Part] = []
        start = 0
        for key, space in dict_space(env, "FlattenUVD").spaces.items():
            part = _part(key, space, start)
            if part is not None:
                parts.append(part)
                start = part.where.stop
        self._parts = tuple(parts)
        self.layout: Mapping[str, slice] = MappingProxyType({part.key: part.where for part in parts})
        """Entries of the observation that come from each key."""
        self.observation_space = spaces.Box(-1.0, 1.0, (start,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray[Any, Any], dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._flat(observation), info

    def step(self, action: Any) -> tuple[np.ndarray[Any, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._flat(observation), reward, terminated, truncated, info

    def _flat(self, observation: Mapping[str, Any]) -> np.ndarray[Any, Any]:
        flat = np.empty(self.observation_space.shape or (0,), dtype=np.float32)
        for part in self._parts:
            values = part.scaled(observation[part.key])
            mask = observation.get(MASK_OF.get(part.key, ""))
            if mask is not None:
                values[np.asarray(mask) == 0] = 0.0
            flat[part.where] = values.ravel()
        return flat.clip(-1.0, 1.0)


@dataclass(frozen=True, eq=False)
class _Part:
    """A key, its entries in the flat observation, and how it is scaled; `unit` None: linearly."""

    key: str
    where: slice
    low: FloatArray | None
    high: FloatArray | None
    unit: float | None

    def scaled(self, observed: Any) -> FloatArray:
        value: FloatArray = np.array(observed, dtype=np.float64)
        if self.low is None or self.high is None:
            return value
        if self.unit is None:
            linear: FloatArray = (2.0 * value - self.low - self.high) / (self.high - self.low)
            return linear
        sizes: FloatArray = np.log1p(np.abs(value) / self.unit) / np.log1p(self.high / self.unit)
        signed: FloatArray = np.copysign(sizes, value)
        return signed


def _part(key: str, space: spaces.Space[Any], start: int) -> _Part | None:
    """How the key goes into the flat observation from `start` on; None: not at all."""
    if isinstance(space, spaces.MultiBinary):
        return _Part(key, slice(start, start + int(np.prod(space.shape))), None, None, None)
    if not isinstance(space, spaces.Box) or not np.issubdtype(space.dtype, np.floating):
        return None
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (high > low).all()):
        raise ValueError(f"observation key {key!r} must be a bounded Box, got {space}: FlattenUVD scales by the bounds")
    return _Part(key, slice(start, start + low.size), low, high, UNITS.get(key))
