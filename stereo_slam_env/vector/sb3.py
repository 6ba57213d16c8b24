"""`SB3VecEnv`: a native vector environment as stable-baselines3 takes it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv


class SB3VecEnv(VecEnv):
    """Gymnasium's vector environment behind the interface of stable-baselines3.

    The two differ in how episodes end: here `infos` of an environment whose episode has ended hold its
    `terminal_observation` and `TimeLimit.truncated`. `infos` of the others are empty but for the `info_keys`, because
    to take arrays apart for a thousand environments takes longer than to step them.

    Parameters
    ----------
    env : gymnasium.vector.VectorEnv
        One that resets its environments in the step in which they end: made with `autoreset_mode="SameStep"`.
    info_keys : sequence of str
        Keys of `info` to hand on.

    Raises
    ------
    ValueError
        The environment resets otherwise.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], info_keys: Sequence[str] = ()) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"env must have autoreset_mode='SameStep', got {mode}: give it to make_vec")
        self.env, self.info_keys = env, tuple(info_keys)
        self.render_mode = None
        self._seed: int | None = None
        self._actions: NDArray[Any] = np.zeros(0)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset: the first environment with `seed`, the others with the following numbers."""
        self._seed = seed
        return [None if seed is None else seed + b for b in range(self.num_envs)]

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        observation, info = self.env.reset(seed=self._seed)
        self._seed = None
        self.reset_infos = self._infos(info)
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step all environments."""
        observation, rewards, terminated, truncated, info = self.env.step(self._actions)
        over = terminated | truncated
        infos = self._infos(info)
        for b in np.flatnonzero(over).tolist():
            last = {key: info["final_info"][key][b] for key in self.info_keys}
            infos[b] = {
                **last,
                "terminal_observation": info["final_obs"][b],
                "TimeLimit.truncated": bool(truncated[b] and not terminated[b]),
            }
        return observation, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Close the environments."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector environment, the same for each."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the environments have no attributes of their own."""
        raise AttributeError(f"{attr_name} cannot be set: the environments are not objects of their own")

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **options: Any) -> list[Any]:
        """Refuse: the environments have no methods of their own."""
        raise AttributeError(f"{method_name} cannot be called: the environments are not objects of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Not one of them is wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def _infos(self, info: dict[str, Any]) -> list[dict[str, Any]]:
        return [{key: info[key][b] for key in self.info_keys} for b in range(self.num_envs)]
