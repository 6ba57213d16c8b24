"""Digest of what a scenario's environment returns to an agent, alone and in a vector."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from stereo_slam_env.benchmark.scenarios.scenario import Scenario

from ..digest import Digest

WAYS = ("environment alone", "vector, sync", "vector, async")
_KINDS = {"street": "StereoSlam/Drive-v0", "gaze": "StereoSlam/Gaze-v0"}
_VECTORS: Mapping[str, Mapping[str, Any]] = {
    "vector, sync": {"vectorization_mode": "sync"},
    # New processes, which share nothing with this one but their arguments.
    "vector, async": {"vectorization_mode": "async", "vector_kwargs": {"context": "spawn"}},
}


def digest_of_episodes(scenario: Scenario, way: str) -> str:
    """SHA-256 of all observations, rewards, ends and infos of an episode for each seed, with seeded actions.

    Parameters
    ----------
    scenario : Scenario
        One that has an environment, and `frames`.
    way : str
        One of `WAYS`.
    """
    arguments = scenario.source.options
    name = arguments.pop("environment", _KINDS[scenario.source.kind])
    seeds, steps = [int(seed) for seed in scenario.seeds], (scenario.frames or 2) - 1
    if way in _VECTORS:
        episodes = _in_a_vector(name, arguments, seeds, steps, _VECTORS[way])
    else:
        episodes = [_alone(name, arguments, seed, steps) for seed in seeds]
    together = Digest()
    together.add("episodes", episodes)
    return together.hex()


def _actions(seed: int, steps: int, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Gentle ones, so that an agent stays on the road for a while; (steps, *shape)."""
    return np.random.default_rng(seed).uniform(-0.3, 0.3, (steps, *shape)).astype(np.float32)


def _alone(name: str, arguments: Mapping[str, Any], seed: int, steps: int) -> str:
    env = gym.make(name, disable_env_checker=True, **arguments)
    digest = Digest()
    try:
        observation, info = env.reset(seed=seed)
        digest.add("reset", {"observation": observation, "info": info})
        assert env.action_space.shape is not None
        for action in _actions(seed, steps, env.action_space.shape):
            observation, reward, terminated, truncated, info = env.step(action)
            digest.add("step", _step(observation, reward, terminated, truncated, info))
            if terminated or truncated:
                break
    finally:
        env.close()
    return digest.hex()


def _in_a_vector(
    name: str, arguments: Mapping[str, Any], seeds: list[int], steps: int, how: Mapping[str, Any]
) -> list[str]:
    vector: Any = gym.make_vec(name, num_envs=len(seeds), **how, **arguments)  # a seed each: its type knows one only
    digests, over = [Digest() for _ in seeds], np.zeros(len(seeds), dtype=bool)
    try:
        observation, info = vector.reset(seed=seeds)
        for number, digest in enumerate(digests):
            digest.add("reset", {"observation": _entry(observation, number), "info": _entry(info, number)})
        shape = vector.single_action_space.shape
        assert shape is not None
        for actions in np.stack([_actions(seed, steps, shape) for seed in seeds], axis=1):
            observation, rewards, terminated, truncated, info = vector.step(actions)
            for number in map(int, np.flatnonzero(~over)):
                ends = rewards[number], terminated[number], truncated[number]
                digests[number].add("step", _step(_entry(observation, number), *ends, _entry(info, number)))
            over |= terminated | truncated  # the episode that follows is another one
    finally:
        vector.close()
    return [digest.hex() for digest in digests]


def _step(observation: Any, reward: Any, terminated: Any, truncated: Any, info: Any) -> dict[str, Any]:
    ends = {"terminated": terminated, "truncated": truncated}
    return {"observation": observation, "reward": reward, **ends, "info": info}


def _entry(batch: Mapping[str, Any], number: int) -> dict[str, Any]:
    """What a vector has of one of its environments, without the masks that say who has told."""
    return {
        key: _entry(value, number) if isinstance(value, Mapping) else value[number]
        for key, value in batch.items()
        if not key.startswith("_")
    }
