"""`SelectedKeys`: some keys of the observation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
from gymnasium import spaces

from filters.contract.validation import require_known
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper
from stereo_slam_env.wrappers.row_wrapper import RowWrapper


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
