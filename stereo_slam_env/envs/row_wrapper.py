"""Wrappers as rows of a `RowsWrapper`: their base, `SelectedKeys` and `DirectionOfGaze`."""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Collection, Mapping, Sequence
from inspect import Signature, signature
from typing import Any, ClassVar, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from filters.contract.validation import one_of, require_known, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Arrays, OneRow, Rows, Seeds, Step, checked_actions
from stereo_slam_env.envs.stereo_env import row_of
from stereo_slam_env.simulator.state import Kept, State
from stereo_slam_env.world.vehicle import Head

_ALL = np.ones(1, dtype=np.bool_)
_NO_STATE = (Kept, gym.Space)
"""Types of attributes that the wrapper itself does not change."""


class _OneClass(ABCMeta):
    """Class of wrappers: around rows it makes an instance, around an environment one of Gymnasium's wrappers."""

    def __init__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any]) -> None:
        super().__init__(name, bases, namespace)
        parameters = list(signature(cls.__init__).parameters.values())[1:]  # type: ignore[misc]
        cls.__signature__ = Signature(parameters)
        about = {"__module__": cls.__module__, "__doc__": cls.__doc__, "__signature__": cls.__signature__}
        cls.Single = type(name, (RowWrapper,), {**about, "OnRows": cls})

    def __call__(cls, env: gym.Env[Any, Any] | Rows, *args: Any, **arguments: Any) -> Any:
        try:
            bound = cls.__signature__.bind(env, *args, **arguments)
        except TypeError as error:
            raise TypeError(f"{cls.__name__}: {error}") from None
        bound.apply_defaults()
        (_, inside), *bound_arguments = bound.arguments.items()
        settings = {name: list(value) if isinstance(value, tuple) else value for name, value in bound_arguments}
        if isinstance(inside, gym.vector.VectorEnv):
            native: Any = inside
            if not isinstance(getattr(native, "rows", None), Rows):
                raise ValueError(f"{cls.__name__} needs a native vector of StereoSlam/..., got {inside}")
            return type(native)(super().__call__(native.rows, **settings), native.autoreset_mode)
        return super().__call__(inside, **settings) if isinstance(inside, Rows) else cls.Single(inside, settings)

    def __instancecheck__(cls, instance: object) -> bool:
        inside = getattr(instance, "rows", None) if isinstance(instance, RowWrapper) else instance
        return super().__instancecheck__(inside)


class RowWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs, Kept):
    """A `RowsWrapper` around a single environment.

    Its arguments are JSON-able and kept: `env.spec` knows the wrapper, and pickle and deepcopy make a fresh one.
    """

    changes = ("rows",)
    OnRows: ClassVar[Any]
    arguments: dict[str, Any]
    """All arguments beside `env`, defaults included."""

    def __init__(self, env: gym.Env[Any, Any], arguments: dict[str, Any]) -> None:
        self.arguments = arguments
        RecordConstructorArgs.__init__(self, **arguments)
        gym.Wrapper.__init__(self, env)
        self.rows: Any = type(self).OnRows(OneRow(env), **arguments)
        self.observation_space, self.action_space = self.rows.observation_space, self.rows.action_space

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (type(self).OnRows, self.env, self.arguments)

    def __getattr__(self, name: str) -> Any:
        if name in type(self).OnRows.shared:
            return getattr(self.rows, name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        self.rows.reset(_ALL, [seed], options or {})
        return self._observe()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment."""
        actions = _one_row(action)
        if self.action_space is not self.env.action_space:  # the environment inside checks its own
            actions = checked_actions("action", actions, self.action_space, 1)
        rewards, terminated, truncated = self.rows.step(actions, _ALL)
        observation, info = self._observe()
        return observation, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info

    def _observe(self) -> tuple[Any, dict[str, Any]]:
        observation, info = self.rows.observe()
        return row_of(observation, 0), row_of(info, 0)


def _one_row(action: Any) -> Any:
    """An action, or each part of one, with a first axis of one row; what is no array stays in a list."""
    if isinstance(action, Mapping):
        return {key: _one_row(part) for key, part in action.items()}
    try:
        return np.asarray(action)[None]
    except ValueError:
        return [action]


def _made_again(kind: Any, env: gym.Env[Any, Any], arguments: dict[str, Any]) -> RowWrapper:
    wrapper: RowWrapper = kind(env, **arguments)
    return wrapper


class RowsWrapper(Rows, metaclass=_OneClass):
    """Rows that pass on what the rows inside say; a subclass changes some of it, and is a wrapper for both.

    `MyWrapper(env, ...)` around one environment is one of Gymnasium's wrappers, around a native vector a vector, and
    around rows rows. The first parameter of `__init__` is called `env`, and is rows there; the others are JSON-able.
    All that it keeps is in its snapshots, but for spaces, functions and what belongs to another wrapper.
    """

    shared: ClassVar[tuple[str, ...]] = ()
    """Attributes that the wrapper around one environment has, too."""

    def __init__(self, env: Any) -> None:
        self.rows: Rows = env
        self.num_envs, self.world = self.rows.num_envs, self.rows.world
        self.observation_space, self.action_space = self.rows.observation_space, self.rows.action_space

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        self.rows.reset(chosen, seeds, options)

    def step(self, actions: Any, going: BoolArray) -> Step:
        return self.rows.step(actions, going)

    def observe(self) -> tuple[Arrays, Arrays]:
        return self.rows.observe()

    def get_attr(self, name: str) -> Any:
        return getattr(self, name) if hasattr(self, name) else self.rows.get_attr(name)

    def select_keys(self, keys: Collection[str]) -> None:
        self.rows.select_keys(keys)

    def _state_names(self) -> Collection[str]:
        """Attributes of its own; objects that keep a state themselves are among them where `changes` names them."""
        foreign = ("rows", "world", "arguments")
        values = {name: value for name, value in vars(self).items() if name not in foreign and not callable(value)}
        return {name for name, value in values.items() if not isinstance(value, _NO_STATE)} | {*self.changes}

    def snapshot(self) -> State:
        """State of a row, that of the rows inside included."""
        return {**super().snapshot(), "rows": self.rows.snapshot()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.rows.restore(state["rows"])
        super().restore(state)

    def close(self) -> None:
        self.rows.close()

    def needed(self, name: str) -> Any:
        """Demand attributes of the rows inside; a `ValueError` says what would offer it."""
        try:
            return self.rows.get_attr(name)
        except AttributeError:
            name, source = (
                ("slam", "BeliefObservation") if name == "beliefs" else (name, "an environment StereoSlam/...")
            )
            raise ValueError(f"{type(self).__name__} needs {name!r}: wrap {source} with it") from None

    def dict_space(self) -> dict[str, spaces.Space[Any]]:
        """The spaces of the observation inside; a `ValueError` where it is no Dict."""
        inside = self.rows.observation_space
        if not isinstance(inside, spaces.Dict):
            raise ValueError(
                f"{type(self).__name__} needs a Dict observation, got {inside}: put what flattens it outside"
            )
        return dict(inside.spaces)

    def only_row(self, name: str) -> int:
        """Number of the only row; an `AttributeError` says that several have no such attribute."""
        if self.num_envs != 1:
            raise AttributeError(f"{self.num_envs} environments have no {name!r} of their own")
        return 0


class PaidRows(RowsWrapper):
    """Rows with a reward of named terms, which `info` has under `reward_...`.

    Parameters
    ----------
    env : gymnasium.Env
        What is paid for happens inside.
    terms : sequence of str
        Names of the terms.
    """

    def __init__(self, env: Any, terms: Sequence[str]) -> None:
        super().__init__(env)
        self._terms = {name: np.zeros(self.num_envs) for name in terms}

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """Start with nothing paid."""
        self.rows.reset(chosen, seeds, options)
        for values in self._terms.values():
            values[chosen] = 0.0

    def paid(self, going: BoolArray, terms: Mapping[str, FloatArray]) -> FloatArray:
        """Keep the terms (B,) of the rows that go on, and return their sums; 0 for the others."""
        total = np.zeros(self.num_envs)
        for name, values in terms.items():
            self._terms[name] = np.where(going, values, self._terms[name])
            total += np.where(going, values, 0.0)
        return total

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        return observation, {**info, **{f"reward_{name}": values.copy() for name, values in self._terms.items()}}


class SelectedKeys(RowsWrapper):
    """Some keys of the Dict observation, or the one array of them all. What is left out is not computed.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation.
    keys : sequence of str
        Those that stay, in their order.
    observation : {"dict", "flat"}
        "flat": one 1-D Box, the keys one after the other as `gymnasium.spaces.flatten` has them, for policies and
        wrappers that know no Dict (`MlpPolicy`, `NormalizeObservation`).

    Raises
    ------
    ValueError
        The observation is no Dict, or is without one of the keys; or one of them cannot be in a flat Box.
    """

    def __init__(self, env: Any, keys: Sequence[str], observation: Literal["dict", "flat"] = "dict") -> None:
        super().__init__(env)
        inner = self.dict_space()
        require_known("the observation has no key", keys, inner)
        one_of("observation", observation, ("dict", "flat"))
        self._flat = observation == "flat"
        selected = spaces.Dict({key: inner[key] for key in keys})
        self.observation_space = spaces.flatten_space(selected) if self._flat else selected
        if not isinstance(self.observation_space, (spaces.Dict, spaces.Box)):
            raise ValueError(f"observation must be 'dict' with these keys, which are no Boxes: {', '.join(keys)}")
        self._keys = list(selected)
        self.rows.select_keys(self._keys)

    def observe(self) -> tuple[Any, Arrays]:
        observation, info = self.rows.observe()
        if not self._flat:
            return {key: observation[key] for key in self._keys}, info
        parts = [np.reshape(observation[key], (self.num_envs, -1)) for key in self._keys]
        return np.concatenate(parts, axis=1).astype(self.observation_space.dtype), info


class DirectionOfGaze(RowsWrapper):
    """The action is the number of a direction to look in, from the farthest left to the farthest right.

    Parameters
    ----------
    env : gymnasium.Env
        With a head.
    pans : int
        Number of directions.
    """

    def __init__(self, env: Any, pans: int = 9) -> None:
        super().__init__(env)
        looks = directions(whole_number("pans", pans, 2))
        moving_head(self.needed("head"))
        size = env.action_space.shape[0]
        self._actions = np.concatenate([np.zeros((pans, size - 2)), looks], axis=1).astype(np.float32)
        self.action_space = spaces.Discrete(pans)

    def step(self, actions: Any, going: BoolArray) -> Step:
        return self.rows.step(self._actions[np.asarray(actions)], going)


def moving_head(head: Any) -> Head:
    """The head of an environment; a `ValueError` where it has none that moves."""
    if not isinstance(head, Head):
        raise ValueError("the policy turns the head, and that of this environment is fixed: use StereoSlam/Gaze-v0")
    return head


def directions(pans: int) -> FloatArray:
    """Pan and tilt as shares of the largest: from left to right, at no tilt; (pans, 2)."""
    return np.column_stack([np.linspace(-1.0, 1.0, pans), np.zeros(pans)])
