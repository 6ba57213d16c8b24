"""Policies by name, those of this package and third-party ones, and their interface.

A third party adds a policy with an entry point in the group `stereo_slam.policies`; the object is called with the
options of the policy and returns a `Policy`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters.contract.validation import did_you_mean, first_line, require_known, type_name
from filters.geometry.arrays import FloatArray
from stereo_slam_env.world.vehicle import Head
from stereo_slam_env.wrappers.direction_of_gaze import moving_head

Action = NDArray[np.float32]


class Policy(Protocol):
    """A policy: decides where to look.

    Policies never look at the truth and never copy the environment. What they may ask it for, with `get_wrapper_attr`,
    are `slam` (the filter in the loop, see `wrappers.BeliefObservation`), `camera`, `noise`, `head`, `head_angles`,
    `route`, the planned drive, and of `options` what the sensors are like (range, noise of the odometry).
    """

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """Begin an episode, which has just begun in `env`.

        Parameters
        ----------
        env : gymnasium.Env
            Reset.
        rng : numpy.random.Generator
            Randomness of the policy.
        """

    def act(self, observation: Mapping[str, Any]) -> Action:
        """The next action, from the observation of the last `reset` or `step`."""


@runtime_checkable
class ActsTogether(Policy, Protocol):
    """A policy that decides in many environments at once; the others are asked one after the other."""

    @staticmethod
    def act_together(policies: Sequence[Any], observations: Sequence[Mapping[str, Any]]) -> Action:
        """The next actions of policies of this class (Q, ...), each as its `act` would decide.

        The policies are made alike, and in rows of one vector of environments.
        """


def require_head(env: gym.Env[Any, Any]) -> Head:
    """The head of an environment; a `ValueError` where it has none that moves."""
    return moving_head(env.get_wrapper_attr("head"))


def look_towards(env: gym.Env[Any, Any], angles: FloatArray) -> Action:
    """The action that turns the head towards pan and tilt (..., 2), rad, and asks for nothing else."""
    head = require_head(env)
    return gaze_action(env, np.clip(angles / np.array(head.max_angles), -1.0, 1.0))


def gaze_action(env: gym.Env[Any, Any], decided: ArrayLike) -> Action:
    """An action (...,) whose last entries are `decided` (..., n), and that asks for nothing else.

    The last two are pan and tilt.
    """
    last = np.asarray(decided, dtype=np.float32)
    assert env.action_space.shape is not None
    action = np.zeros((*last.shape[:-1], *env.action_space.shape), dtype=np.float32)
    action[..., -last.shape[-1] :] = last
    return action


ENTRY_POINT_GROUP = "stereo_slam.policies"

_OWN = {
    "fixed": "open_loop:FixedGaze",
    "random": "open_loop:RandomGaze",
    "sweep": "open_loop:Sweep",
    "most-uncertain": "planning:MostUncertain",
    "greedy": "planning:Greedy",
    "lookahead": "planning:Lookahead",
    "ppo": "network:NetworkPolicy",
}


def make_policy(name: str, **options: Any) -> Policy:
    """Make a policy by name.

    Parameters
    ----------
    name : str
        One of `available_policies()`.
    **options
        The policy's own, JSON-able.

    Raises
    ------
    ValueError
        Unknown name or option, an option's value is refused, or a third-party policy cannot be loaded.
    """
    factory = _found(name)
    parameters = inspect.signature(factory).parameters
    require_known(f"policy {name!r} has no option", options, parameters)
    made: Policy = factory(**options)
    return made


def plugin_of(name: str) -> EntryPoint | None:
    """The entry point of a third-party policy; None for one of ours."""
    return None if name in _OWN else _entry_points().get(name)


def available_policies() -> dict[str, str]:
    """Names and one line on each."""
    return {name: (inspect.getdoc(_found(name)) or "no description").splitlines()[0] for name in _entry_points()}


def _own_entry_points() -> dict[str, EntryPoint]:
    return {name: EntryPoint(name, f"{__package__}.{what}", ENTRY_POINT_GROUP) for name, what in _OWN.items()}


def _entry_points() -> dict[str, EntryPoint]:
    """Ours, and those of third parties that have another name."""
    own = _own_entry_points()
    return {**own, **{point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in own}}


def _found(name: str) -> Callable[..., Any]:
    known = _own_entry_points()
    if name not in known:
        known = _entry_points()  # asks every installed package: a tenth of a second
    if name not in known:
        raise ValueError(f"policy must be one of {', '.join(known)}, got {name!r}{did_you_mean(name, known)}")
    point = known[name]
    try:
        found: Callable[..., Any] = point.load()
    except Exception as error:  # whatever a stranger's module does at import must not take the run down
        raise ValueError(
            f"policy {name!r} ({point.value}) cannot be loaded: {type_name(error)}: {first_line(error)}"
        ) from error
    return found
