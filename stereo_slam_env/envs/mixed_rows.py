"""`MixedRows`: rows of several worlds side by side, for policies that are learnt in all of them at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from filters.geometry.arrays import BoolArray
from stereo_slam_env.envs.rows import Arrays, Rows, Seeds, Step
from stereo_slam_env.simulator.state import State


class MixedRows(Rows):
    """Rows of several kinds, one kind after the other; what they show and take must have the same shapes.

    Parameters
    ----------
    parts : sequence of Rows
        At least one.

    Raises
    ------
    ValueError
        Two of them show or take something else.
    """

    def __init__(self, parts: Sequence[Rows]) -> None:
        self.parts, first = list(parts), parts[0]
        self.observation_space, self.action_space, self.world = first.observation_space, first.action_space, first.world
        for part in self.parts:
            if _shapes(part) != _shapes(first):
                raise ValueError(f"worlds must show and take the same, got {_shapes(first)} and {_shapes(part)}")
        self.num_envs = sum(part.num_envs for part in self.parts)
        ends = np.cumsum([part.num_envs for part in self.parts]).tolist()
        self._slices = [slice(end - part.num_envs, end) for end, part in zip(ends, self.parts, strict=True)]

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        for part, rows in zip(self.parts, self._slices, strict=True):
            if chosen[rows].any():
                part.reset(chosen[rows], seeds[rows], options)

    def step(self, actions: Any, going: BoolArray) -> Step:
        steps = [part.step(actions[rows], going[rows]) for part, rows in zip(self.parts, self._slices, strict=True)]
        rewards, terminated, truncated = (np.concatenate(column) for column in zip(*steps, strict=True))
        return rewards, terminated, truncated

    def observe(self) -> tuple[Arrays, Arrays]:
        observations, infos = zip(*(part.observe() for part in self.parts), strict=True)
        return _joined(observations), _joined(infos)

    def get_attr(self, name: str) -> Any:
        return self.parts[0].get_attr(name)

    def select_keys(self, keys: Collection[str]) -> None:
        for part in self.parts:
            part.select_keys(keys)

    def snapshot(self) -> State:
        return {"parts": [part.snapshot() for part in self.parts]}

    def restore(self, state: Mapping[str, Any]) -> None:
        for part, kept in zip(self.parts, state["parts"], strict=True):
            part.restore(kept)

    def close(self) -> None:
        for part in self.parts:
            part.close()


def _shapes(rows: Rows) -> Any:
    space = rows.observation_space
    shown = {key: part.shape for key, part in space.items()} if isinstance(space, spaces.Dict) else space.shape
    return shown, rows.action_space.shape


def _joined(parts: Sequence[Any]) -> Any:
    """Arrays of all parts, one after the other; of a dictionary the keys that all of them have."""
    if isinstance(parts[0], Mapping):
        shared = [key for key in parts[0] if all(key in part for part in parts)]
        return {key: _joined([part[key] for part in parts]) for key in shared}
    return np.concatenate([np.asarray(part) for part in parts])
