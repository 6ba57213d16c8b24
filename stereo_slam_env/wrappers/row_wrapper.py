"""Base of the wrappers: a row of a `RowsWrapper`, made again from its arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from stereo_slam_env.envs.rows import OneRow, Rows, RowsWrapper, checked_actions
from stereo_slam_env.envs.stereo_env import row_of
from stereo_slam_env.simulator.state import Kept

_ALL = np.ones(1, dtype=np.bool_)


class RowWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs, Kept):
    """A wrapper that does what its `OnRows` does on many rows, on one.

    Arguments of `OnRows` are the rows inside, and by their names those of the wrapper. They are JSON-able and kept:
    `env.spec` knows the wrapper, and pickle and deepcopy make a fresh one.
    """

    changes = ("rows",)
    OnRows: ClassVar[Callable[..., RowsWrapper]]
    arguments: dict[str, Any]
    """All arguments beside `env`, defaults included."""

    def __new__(cls, env: gym.Env[Any, Any], *args: Any, **arguments: Any) -> RowWrapper:
        """Keep the arguments of the subclass, defaults included."""
        made = super().__new__(cls)
        made.arguments = cls._bound(env, *args, **arguments)
        return made

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self, **self.arguments)
        gym.Wrapper.__init__(self, env)
        self.rows: Any = type(self).OnRows(OneRow(env), **self.arguments)
        self.observation_space, self.action_space = self.rows.observation_space, self.rows.action_space

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (type(self), self.env, self.arguments)

    @classmethod
    def _bound(cls, env: object, *args: Any, **arguments: Any) -> dict[str, Any]:
        """All arguments beside `env`, defaults included."""
        bound = signature(cls).bind(env, *args, **arguments)
        bound.apply_defaults()
        given = list(bound.arguments.items())[1:]
        return {name: list(value) if isinstance(value, tuple) else value for name, value in given}

    def inner(self, name: str) -> Any:
        """Attribute `name` of the environment or of a wrapper inside; a `ValueError` says what would offer it."""
        try:
            return self.env.get_wrapper_attr(name)
        except AttributeError:
            source = "BeliefObservation" if name in ("slam", "belief") else "an environment StereoSlam/..."
            raise ValueError(f"{type(self).__name__} needs {name!r}: wrap {source} with it") from None

    @classmethod
    def around(cls, inside: gym.Env[Any, Any] | Rows, **arguments: Any) -> Any:
        """The wrapper around one environment, or around rows."""
        if isinstance(inside, Rows):
            return cls.OnRows(inside, **cls._bound(inside, **arguments))
        return cls(inside, **arguments)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        self.rows.begin(_ALL, [seed], options or {})
        return self._look()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment."""
        actions = _one_row(action)
        if self.action_space is not self.env.action_space:  # the environment inside checks its own
            actions = checked_actions("action", actions, self.action_space, 1)
        rewards, terminated, truncated = self.rows.advance(actions, _ALL)
        observation, info = self._look()
        return observation, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info

    def _look(self) -> tuple[Any, dict[str, Any]]:
        observation, info = self.rows.look()
        return row_of(observation, 0), row_of(info, 0)


def _one_row(action: Any) -> Any:
    """An action, or each part of one, with a first axis of one row; what is no array stays in a list."""
    if isinstance(action, Mapping):
        return {key: _one_row(part) for key, part in action.items()}
    try:
        return np.asarray(action)[None]
    except ValueError:
        return [action]


def _made_again(kind: type[RowWrapper], env: gym.Env[Any, Any], arguments: dict[str, Any]) -> RowWrapper:
    return kind(env, **arguments)
