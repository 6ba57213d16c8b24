"""`SequenceObservation`: as many rows as there are landmarks."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium import spaces

from stereo_slam_env.wrappers.padded_rows import MASK_OF, ROWS
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space


class SequenceObservation(RecordedWrapper):
    """Padded keys as `Sequence` spaces, for networks that take sets.

    `uvd` and `ids` (and the landmarks of `BeliefObservation`) become stacked sequences: arrays of as many rows as
    there are landmarks, without padding; `mask` and `belief_mask` go. Other keys stay.

    Stable-baselines3 and Minari refuse such spaces, and `AsyncVectorEnv` takes them only with `shared_memory=False`;
    synchronous vector environments give tuples.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation.

    Raises
    ------
    ValueError
        The observation is no Dict.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        inner = dict_space(env, "SequenceObservation").spaces
        self.observation_space = spaces.Dict(
            {
                key: _rows_of(space) if MASK_OF.get(key) in inner else space
                for key, space in inner.items()
                if key not in ROWS
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        return _without_padding(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return _without_padding(observation), reward, terminated, truncated, info


def _rows_of(space: spaces.Space[Any]) -> spaces.Sequence:
    assert isinstance(space, spaces.Box)
    if space.low.ndim == 1:  # ids: a Box without a shape would refuse the numbers of an array
        return spaces.Sequence(spaces.Discrete(int(space.high[0]) + 1), stack=True)
    return spaces.Sequence(spaces.Box(space.low[0], space.high[0], dtype=space.dtype.type), stack=True)


def _without_padding(observation: dict[str, Any]) -> dict[str, Any]:
    rows = dict(observation)
    counts = {mask: int(rows.pop(mask).sum()) for mask in ROWS if mask in rows}
    for mask, count in counts.items():
        for key in ROWS[mask]:
            rows[key] = rows[key][:count].copy()
    return rows
