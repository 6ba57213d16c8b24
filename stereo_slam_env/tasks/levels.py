"""Levels of difficulty, and a curriculum that goes through them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import gymnasium as gym

from filters.contract.validation import one_of, positive, whole_number
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper
from stereo_slam_env.wrappers.vectors import rows_of

LEVELS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "easy": {"sigma": 0.5, "odometry_sigma_linear": 0.05, "odometry_sigma_angular": 0.005},
        "normal": {},
        "hard": {
            "sigma": 1.25,
            "odometry_sigma_linear": 0.2,
            "odometry_sigma_angular": 0.02,
            "visibility": 25.0,
            "moving_cars": 4,
            "pedestrians": 4,
            "randomise": True,
        },
    }
)
"""Arguments of the environment at each level: noise, fog, traffic, textures and light. "normal": those of the task."""
WORLDS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "white": {"sigma": 1.0},
        "lasting": {"sigma": 0.714, "lasting": 0.7, "lasting_time": 2.0},
        "front-end": {"sigma": 0.036, "lasting": 0.114, "lasting_time": 1.7},
    }
)
"""Arguments of environments whose landmarks have errors of one kind: white; with the same R, half of it lasting; as the
front end has them in rendered images (a standard deviation of 0.12 px, correlations of 0.86 after one frame and 0.68
after five, see the page on the front end)."""
_TRAFFIC = ("moving_cars", "pedestrians")


def of_level(level: str, *, scripted: bool) -> Mapping[str, Any]:
    """Arguments of the environment at a level of `LEVELS`; without traffic where no script drives.

    Traffic keeps time with the script, and an agent that drives is not shown it, so it would be hit without a fault of
    its own. In scripted drives it hides landmarks.
    """
    one_of("level", level, LEVELS)
    return {key: value for key, value in LEVELS[level].items() if scripted or key not in _TRAFFIC}


def of_world(arguments: Mapping[str, Any] | None, others: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of the environment inside a task, from the mapping of that name and those given beside it."""
    given = {} if arguments is None else arguments
    if not isinstance(given, Mapping):
        raise ValueError(f"arguments must be a mapping of arguments of the environment, got {given!r}")
    if twice := sorted(given.keys() & others.keys()):
        raise ValueError(f"{twice[0]} is given twice, in arguments and beside it: leave one of them out")
    return {**given, **others}


def inner_environment(
    name: str, level: str, given: Mapping[str, Any], many: Mapping[str, Any] | None, **own: Any
) -> gym.Env[Any, Any] | Rows:
    """The environment `name` inside a task: its own arguments, those of the level, and those given; the last ones win.

    Rows of such where `many` has their number, see `wrappers.vectors.rows_of`.
    """
    arguments = {**own, **of_level(level, scripted=name == "StereoSlam/Gaze-v0"), **given}
    if many is not None:
        return rows_of(name, options=arguments, **many)
    return gym.make(name, max_episode_steps=-1, disable_env_checker=True, **arguments)


class Curriculum(RecordedWrapper):
    """Begins at the first level, and goes on to the next one when the agent succeeds often enough.

    At `reset`, when `info["is_success"]` was true at the end of a share of at least `rate` of the last `window`
    episodes at this level, the environment is made again at the next one. `info` gains `level`, its number. Episodes
    that were not brought to their end do not count. Pickle and `env.spec` make a curriculum at its beginning.

    Parameters
    ----------
    env : gymnasium.Env
        Made by `gymnasium.make` from an id with the argument `level`.
    levels : sequence of str
        Names of `LEVELS`, in their order.
    window : int
        Episodes.
    rate : float
        Share of successes, above 0.

    Raises
    ------
    ValueError
        A level is unknown, the environment has no spec, or its spaces are not the same at every level.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        levels: Sequence[str] = ("easy", "normal", "hard"),
        window: int = 20,
        rate: float = 0.8,
    ) -> None:
        super().__init__(env)
        for level in levels:
            one_of("level", level, LEVELS)
        if env.spec is None:
            raise ValueError("Curriculum makes its environment again: give one that gymnasium.make has made")
        self._spec, self._levels, self._rate = env.spec, tuple(levels), positive("rate", rate)
        self._successes: deque[bool] = deque(maxlen=whole_number("window", window, 1))
        self._number = -1

    @property
    def level(self) -> str:
        """Name of the level of this episode."""
        return self._levels[max(self._number, 0)]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, at the next level if that is earned."""
        earned = len(self._successes) == self._successes.maxlen and self._share >= self._rate
        if self._number < 0 or (earned and self._number + 1 < len(self._levels)):
            self._number += 1
            self._successes.clear()
            if seed is None and self._number > 0:
                seed = int(self.env.np_random.integers(2**31))  # so that the new environment goes on reproducibly
            self._make()
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, {**info, "level": self._number}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and count the success of an episode that ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._successes.append(bool(info["is_success"]))
        return observation, reward, terminated, truncated, {**info, "level": self._number}

    @property
    def _share(self) -> float:
        return sum(self._successes) / len(self._successes)

    def _make(self) -> None:
        spaces = self.observation_space, self.action_space
        self.env.close()
        self.env = gym.make(self._spec, level=self.level)
        if (self.env.observation_space, self.env.action_space) != spaces:
            raise ValueError(f"the spaces at level {self.level!r} must be those of the others")
