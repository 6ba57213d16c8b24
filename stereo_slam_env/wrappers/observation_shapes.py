"""Shapes of the observation for learners: one flat Box, some keys, or sequences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.contract.known_names import require_known
from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper
from stereo_slam_env.wrappers.recorded_wrapper import RowWrapper

ROWS: Mapping[str, tuple[str, ...]] = {
    "mask": ("uvd", "ids"),
    "belief_mask": ("belief_landmark_ids", "belief_landmarks", "belief_landmark_covariances"),
}
"""Mask -> the keys whose rows it counts; rows in use come first."""
_MASK_OF = {key: mask for mask, keys in ROWS.items() for key in keys}

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


class FlattenUVDRows(RowsWrapper):
    """What `FlattenUVD` does, on rows; see there."""

    def __init__(self, rows: Rows) -> None:
        super().__init__(rows)
        self._scales: dict[str, tuple[FloatArray, FloatArray, float | None]] = {}
        layout: dict[str, slice] = {}
        size = 0
        for key, space in self.dict_space().items():
            if key in ROWS:
                high: FloatArray = np.ones(space.shape or ())
                low: FloatArray = -high
            elif isinstance(space, spaces.Box) and np.issubdtype(space.dtype, np.floating):
                low, high = space.low.astype(np.float64), space.high.astype(np.float64)
            else:
                continue
            if not (np.isfinite(low).all() and np.isfinite(high).all() and (high > low).all()):
                raise ValueError(
                    f"observation key {key!r} must be a bounded Box, got {space}: FlattenUVD scales by the bounds"
                )
            self._scales[key] = low, high, UNITS.get(key)
            layout[key] = slice(size, size + low.size)
            size += low.size
        self.layout: Mapping[str, slice] = MappingProxyType(layout)
        self.observation_space = spaces.Box(-1.0, 1.0, (size,), np.float32)

    def look(self) -> tuple[Any, Arrays]:
        """See `Rows`; the flat observations are (B, size)."""
        observation, info = self.rows.look()
        flat = np.empty((self.count, *self.observation_space.shape), dtype=np.float32)
        for key, (low, high, unit) in self._scales.items():
            values = np.array(observation[key], dtype=np.float64)
            if unit is None:
                values = (2.0 * values - low - high) / (high - low)
            else:
                values = np.copysign(np.log1p(np.abs(values) / unit) / np.log1p(high / unit), values)
            mask = observation.get(_MASK_OF.get(key, ""))
            if mask is not None:
                values[np.asarray(mask) == 0] = 0.0
            flat[:, self.layout[key]] = values.reshape(self.count, -1)
        return flat.clip(-1.0, 1.0), info


class FlattenUVD(RowWrapper):
    """The Dict observation as one 1-D float32 Box in [-1, 1].

    In the order of the Dict's keys, each raveled; `layout` says which entries belong to which key:

    - Boxes of floats (`uvd`, `odometry`, `head`, `panorama`, ...), linearly: -1 and 1 are the bounds;
    - positions, covariances and sigmas of the belief, which spread over orders of magnitude: sign(x)
      log(1 + |x| / s) / log(1 + b / s), with b the bound and s the unit of `UNITS`;
    - masks as 0 and 1. Rows that they do not count are 0;
    - integers (ids, which are names and no numbers, and images) are left out.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation of bounded Boxes.

    Raises
    ------
    ValueError
        The observation is no Dict, or a Box in it is not bounded.
    """

    OnRows = FlattenUVDRows

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)

    @property
    def layout(self) -> Mapping[str, slice]:
        """Entries of the observation that come from each key."""
        layout: Mapping[str, slice] = self.rows.layout
        return layout


class SelectedKeysRows(RowsWrapper):
    """What `SelectedKeys` does, on rows."""

    def __init__(self, rows: Rows, keys: Sequence[str]) -> None:
        super().__init__(rows)
        inner = self.dict_space()
        require_known("the observation has no key", keys, inner)
        self.observation_space, self._keys = spaces.Dict({key: inner[key] for key in keys}), list(keys)
        rows.want(self._keys)

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`."""
        observation, info = self.rows.look()
        return {key: observation[key] for key in self._keys}, info


class SelectedKeys(RowWrapper):
    """Some keys of the Dict observation. Unlike `gymnasium.wrappers.FilterObservation` it can be pickled.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation.
    keys : sequence of str
        Those that stay.

    Raises
    ------
    ValueError
        The observation is no Dict, or is without one of the keys.
    """

    OnRows = SelectedKeysRows

    def __init__(self, env: gym.Env[Any, Any], keys: Sequence[str]) -> None:
        super().__init__(env)


class SequenceObservationRows(RowsWrapper):
    """What `SequenceObservation` does, on rows; see there."""

    def __init__(self, rows: Rows) -> None:
        super().__init__(rows)
        inner = self.dict_space()
        self.observation_space = spaces.Dict(
            {
                key: _sequence(space) if _MASK_OF.get(key) in inner else space
                for key, space in inner.items()
                if key not in ROWS
            }
        )

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`; sequences are a tuple of arrays, one for each row."""
        observation, info = self.rows.look()
        for mask, keys in ROWS.items():
            if mask in observation:
                counts = observation.pop(mask).sum(axis=1).tolist()
                for key in keys:
                    if key in observation:
                        pairs = zip(observation[key], counts, strict=True)
                        observation[key] = tuple(values[:count].copy() for values, count in pairs)
        return observation, info


class SequenceObservation(RowWrapper):
    """Padded keys as `Sequence` spaces, for networks that take sets.

    `uvd` and `ids` (and the landmarks of `BeliefObservation`) become stacked sequences: arrays of as many rows as
    there are landmarks, without padding; `mask` and `belief_mask` go. Other keys stay.

    Stable-baselines3 and Minari refuse such spaces, and `AsyncVectorEnv` takes them only with `shared_memory=False`;
    vectors give tuples, synchronous and native ones.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation.

    Raises
    ------
    ValueError
        The observation is no Dict.
    """

    OnRows = SequenceObservationRows

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)


def _sequence(space: spaces.Space[Any]) -> spaces.Sequence:
    assert isinstance(space, spaces.Box)
    if space.low.ndim == 1:  # ids: a Box without a shape would refuse the numbers of an array
        return spaces.Sequence(spaces.Discrete(int(space.high[0]) + 1), stack=True)
    return spaces.Sequence(spaces.Box(space.low[0], space.high[0], dtype=space.dtype.type), stack=True)
