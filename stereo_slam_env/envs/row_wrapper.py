"""Wrappers as rows of a `RowsWrapper`: their base, `SelectedKeys` and `DirectionOfGaze`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from filters.contract.validation import require_known, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Arrays, OneRow, Rows, RowsWrapper, Step, checked_actions
from stereo_slam_env.envs.stereo_env import row_of
from stereo_slam_env.simulator.state import Kept
from stereo_slam_env.world.vehicle import Head

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
        wrapper = super().__new__(cls)
        wrapper.arguments = cls._bound(env, *args, **arguments)
        return wrapper

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
        bound_arguments = list(bound.arguments.items())[1:]
        return {name: list(value) if isinstance(value, tuple) else value for name, value in bound_arguments}

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


class SelectedKeysRows(RowsWrapper):
    """Implementation of `SelectedKeys` on rows."""

    def __init__(self, rows: Rows, keys: Sequence[str]) -> None:
        super().__init__(rows)
        inner = self.dict_space()
        require_known("the observation has no key", keys, inner)
        self.observation_space, self._keys = spaces.Dict({key: inner[key] for key in keys}), list(keys)
        rows.want(self._keys)

    def look(self) -> tuple[Arrays, Arrays]:
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


class DirectionOfGazeRows(RowsWrapper):
    """Implementation of `DirectionOfGaze` on rows."""

    def __init__(self, rows: Rows, pans: int) -> None:
        super().__init__(rows)
        looks = directions(whole_number("pans", pans, 2))
        moving_head(self.needed("head"))
        size = rows.action_space.shape[0]
        self._actions = np.concatenate([np.zeros((pans, size - 2)), looks], axis=1).astype(np.float32)
        self.action_space = spaces.Discrete(pans)

    def advance(self, actions: Any, going: BoolArray) -> Step:
        return self.rows.advance(self._actions[np.asarray(actions)], going)


class DirectionOfGaze(RowWrapper):
    """The action is the number of a direction to look in, from the farthest left to the farthest right.

    Parameters
    ----------
    env : gymnasium.Env
        With a head.
    pans : int
        Number of directions.
    """

    OnRows = DirectionOfGazeRows

    def __init__(self, env: gym.Env[Any, Any], pans: int = 9) -> None:
        super().__init__(env)


def moving_head(head: Any) -> Head:
    """The head of an environment; a `ValueError` where it has none that moves."""
    if not isinstance(head, Head):
        raise ValueError("the policy turns the head, and that of this environment is fixed: use StereoSlam/Gaze-v0")
    return head


def directions(pans: int) -> FloatArray:
    """Pan and tilt as shares of the largest: from left to right, at no tilt; (pans, 2)."""
    return np.column_stack([np.linspace(-1.0, 1.0, pans), np.zeros(pans)])
