"""From a scenario of kind "gaze", a seed and a competitor to the episode that the competitor drives itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import gymnasium as gym
from threadpoolctl import threadpool_limits

from filters.common_options import make_with_common_options
from filters.known_names import did_you_mean
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.envs.stereo_env import StereoEnv
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.episode import Episode, run_episode
from stereo_slam_env.policies.open_loop import FixedGaze
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama

DEFAULT_ENVIRONMENT = "StereoSlam/Gaze-v0"


def drive_episode(
    scenario: Scenario, seed: int, choice: FilterChoice, progress: Callable[[int, int], None] | None = None
) -> Episode:
    """Let the policy of a competitor look through an episode, with its filter in the loop.

    The filter is made and told exactly what `run_filter` makes and tells it, so that a run over the recording says what
    the policy heard.

    Parameters
    ----------
    scenario : Scenario
        Of kind "gaze".
    seed : int
        Of the episode.
    choice : FilterChoice
        One of `scenario.competitors`.
    progress : callable, optional
        Called with (frames done, frames) after each.
    """
    assert choice.policy is not None
    core = make_environment(scenario)
    try:
        noise = scenario.assumed_noise(core.get_wrapper_attr("noise"))
        options = make_with_common_options(
            choice.name, core.get_wrapper_attr("camera"), noise, choice.options, scenario.common_options
        ).options
        env = BeliefPanorama(
            BeliefObservation(
                core,
                filter=choice.name,
                options=options,
                noise=noise.R.tolist(),
                use_odometry=scenario.use_odometry,
            )
        )
        policy = make_policy(choice.policy.name, **choice.policy.options)
        about = {"policy": dataclasses.asdict(choice.policy), "filter": {"name": choice.name, "options": options}}
        with threadpool_limits(limits=1):
            return run_episode(env, policy, seed, frames=scenario.frames, progress=progress, about=about)
    finally:
        core.close()


def drive_straight_ahead(scenario: Scenario, seed: int) -> Episode:
    """The episode of nobody in particular: eyes ahead and no filter."""
    env = make_environment(scenario)
    try:
        return run_episode(env, FixedGaze(), seed, frames=scenario.frames)
    finally:
        env.close()


def make_environment(scenario: Scenario) -> gym.Env[Any, Any]:
    """The environment of a scenario of kind "gaze".

    Raises
    ------
    ValueError
        There is no such environment, it refuses an argument, its head does not move, or its car follows no route.
    """
    arguments = dict(scenario.options)
    name = arguments.pop("environment", DEFAULT_ENVIRONMENT)
    if name not in gym.registry:
        known = sorted(known for known in gym.registry if known.startswith("StereoSlam/"))
        raise ValueError(f"environment must be one of {', '.join(known)}, got {name!r}{did_you_mean(str(name), known)}")
    env = gym.make(name, disable_env_checker=True, **arguments)
    core = env.unwrapped
    if not isinstance(core, StereoEnv) or core.head is None:
        raise ValueError(f"environment {name} has no head that a policy could turn: take {DEFAULT_ENVIRONMENT}")
    if getattr(core.options, "policy", "route") != "route":
        raise ValueError(f"environment {name} must follow its route, so that all see the same drive: policy = 'route'")
    return env


def check_episodes(scenario: Scenario) -> None:
    """Raise a `ValueError` for an environment or a policy that cannot be used as the scenario says."""
    env = make_environment(scenario)
    route = env.get_wrapper_attr("route")
    env.close()
    if scenario.frames is not None and scenario.frames > route.frames:
        raise ValueError(f"frames must be at most {route.frames} on this route, got {scenario.frames}")
    for choice in scenario.policies:
        make_policy(choice.name, **choice.options)
