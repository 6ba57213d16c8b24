"""Base of the wrappers: a wrapper that is made again from its arguments, by `gym.make` and by pickle."""

from __future__ import annotations

from inspect import signature
from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs


class RecordedWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Wrapper whose arguments are kept: `env.spec` knows it, and pickle and deepcopy make a fresh one, no snapshot.

    Arguments of subclasses beside `env` are JSON-able.
    """

    arguments: dict[str, Any]
    """All arguments beside `env`, defaults included."""

    def __new__(cls, env: gym.Env[Any, Any], *args: Any, **arguments: Any) -> RecordedWrapper:
        """Keep the arguments of the subclass, defaults included."""
        made = super().__new__(cls)
        bound = signature(cls).bind(env, *args, **arguments)
        bound.apply_defaults()
        given = list(bound.arguments.items())[1:]
        made.arguments = {name: list(value) if isinstance(value, tuple) else value for name, value in given}
        return made

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self, **self.arguments)
        gym.Wrapper.__init__(self, env)

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, (type(self), self.env, self.arguments)

    def inner(self, name: str) -> Any:
        """Attribute `name` of the environment or of a wrapper inside; a `ValueError` says what would offer it."""
        try:
            return self.env.get_wrapper_attr(name)
        except AttributeError:
            source = "BeliefObservation" if name in ("slam", "belief") else "an environment StereoSlam/..."
            raise ValueError(f"{type(self).__name__} needs {name!r}: wrap {source} with it") from None


def dict_space(env: gym.Env[Any, Any], user: str) -> gym.spaces.Dict:
    """The observation space of `env`, which must be a Dict for the wrapper called `user`."""
    if not isinstance(env.observation_space, gym.spaces.Dict):
        raise ValueError(f"{user} needs a Dict observation, got {env.observation_space}: put it inside FlattenUVD")
    return env.observation_space


def _made_again(kind: type[RecordedWrapper], env: gym.Env[Any, Any], arguments: dict[str, Any]) -> RecordedWrapper:
    return kind(env, **arguments)
