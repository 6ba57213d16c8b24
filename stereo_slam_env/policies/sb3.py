"""Vector environments of Gymnasium for the learners of stable-baselines3, which do not take them as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from filters.contract.extras import require_module
from filters.geometry.arrays import BoolArray

require_module("stable_baselines3", "rl")

from stable_baselines3.common.vec_env import VecEnv  # noqa: E402
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn  # noqa: E402

_AT_THE_END = ("is_success", "episode")
"""Keys of `info` that the loggers of stable-baselines3 read when an episode ends."""


class SB3VecEnv(VecEnv):
    """A `gymnasium.vector.VectorEnv` as a `VecEnv` of stable-baselines3.

    stable-baselines3 wants a list of dictionaries for `info`, which costs more than many an environment. So only what
    its learners and loggers use is in it: `terminal_observation`, `TimeLimit.truncated`, `is_success` and `episode`
    where an episode ends, and `info_keys`.

    Parameters
    ----------
    vector_env : gymnasium.vector.VectorEnv
        Environments that start again in the same step, or not by themselves: `autoreset_mode` SAME_STEP or DISABLED.
        The wrappers of observations in `gymnasium.wrappers.vector` need DISABLED.
    info_keys : sequence of str
        Keys of `info` that are passed on in each step.

    Raises
    ------
    ImportError
        stable-baselines3 is missing.
    ValueError
        The environments have another `autoreset_mode`.
    """

    def __init__(self, vector_env: gym.vector.VectorEnv[Any, Any, Any], info_keys: Sequence[str] = ()) -> None:
        mode = vector_env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        if mode not in (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED):
            raise ValueError(
                f"stable-baselines3 needs autoreset_mode=AutoresetMode.SAME_STEP or DISABLED, the vector has {mode}"
            )
        self.vector_env = vector_env
        self.info_keys = tuple(info_keys)
        self._resets_itself = mode == AutoresetMode.SAME_STEP
        self._actions: NDArray[Any] | None = None
        super().__init__(vector_env.num_envs, vector_env.single_observation_space, vector_env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment, with the seeds and options that were set before."""
        if any(options != self._options[0] for options in self._options):
            raise ValueError("the environments of a vector have the same options")
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        observation: VecEnvObs
        observation, info = self.vector_env.reset(seed=seeds, options=self._options[0] or None)  # type: ignore[arg-type]
        self.reset_infos = self._infos(info)
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step; where an episode ends, the observation is the first of the next."""
        observation, rewards, terminated, truncated, info = self.vector_env.step(self._actions)
        over = terminated | truncated
        infos = self._infos(info)
        if over.any():
            if self._resets_itself:
                last, last_info = list(info["final_obs"]), info["final_info"]
            else:
                last, last_info = _rows(observation, over), info
                observation, _ = self.vector_env.reset(options={"reset_mask": over})
            # A wrapper around the environments, as `RecordEpisodeStatistics`, puts its keys beside `final_info`.
            last_info = {**{key: info[key] for key in _AT_THE_END if key in info}, **last_info}
            keys = [*self.info_keys, *(key for key in _AT_THE_END if key in last_info)]
            for b in np.flatnonzero(over).tolist():
                infos[b] = {key: _row(last_info[key], b) for key in keys}
                infos[b]["terminal_observation"] = last[b]
                infos[b]["TimeLimit.truncated"] = bool(truncated[b] and not terminated[b])
        return observation, np.asarray(rewards, dtype=np.float32), over, infos

    def close(self) -> None:
        """Close the environments."""
        self.vector_env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the vector, which is the same for each environment."""
        value = getattr(self.vector_env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector; not of some of its environments."""
        self._all_of_them(indices)
        setattr(self.vector_env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector once; its result for each environment."""
        self._all_of_them(indices)
        return [getattr(self.vector_env, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """Whether the environments have a wrapper for single ones: no."""
        return [False for _ in self._get_indices(indices)]

    def _all_of_them(self, indices: VecEnvIndices) -> None:
        if sorted(self._get_indices(indices)) != list(range(self.num_envs)):
            raise ValueError(f"what is done to one environment of a vector is done to all: got indices {indices}")

    def _infos(self, info: dict[str, Any]) -> list[dict[str, Any]]:
        """`info_keys` of each environment."""
        if not self.info_keys:
            return [{} for _ in range(self.num_envs)]
        columns = [info[key] for key in self.info_keys]
        return [dict(zip(self.info_keys, values, strict=True)) for values in zip(*columns, strict=True)]


def _rows(observation: Any, which: BoolArray) -> list[Any]:
    """Observations of single environments, None where they are not asked for."""
    return [_row(observation, b) if is_chosen else None for b, is_chosen in enumerate(which.tolist())]


def _row(batch: Any, b: int) -> Any:
    """Part of environment b of an array, or of a dictionary or a tuple of them."""
    if isinstance(batch, dict):
        return {key: _row(value, b) for key, value in batch.items()}
    if isinstance(batch, tuple):
        return tuple(_row(value, b) for value in batch)
    row = batch[b]
    return row.copy() if isinstance(row, np.ndarray) else row
