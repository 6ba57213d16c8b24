"""Levels of difficulty, and worlds whose landmarks have errors of one kind."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import gymnasium as gym

from filters.contract.validation import one_of
from stereo_slam_env.envs.rows import Rows
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
