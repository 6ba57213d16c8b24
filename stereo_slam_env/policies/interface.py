"""The interface of policies, and actions that turn the head."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

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
