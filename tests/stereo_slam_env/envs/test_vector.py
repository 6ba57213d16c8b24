"""Vectors of all kinds: the same bits as single environments stepped by hand, over the ends of episodes too."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import stereo_slam_env  # noqa: F401 (registers the ids)

IDS = ["StereoSlam/Drive-v0", "StereoSlam/Gaze-v0"]
QUICK = {"route": "right-turn", "rig": "qvga", "max_landmarks": 20}
EPISODE, STEPS, SEEDS, OTHER_SEED = 2, 5, [11, 12], 13
"""Environment 1 starts again after the first step, so that episodes end in different steps of the vector."""
NEXT_STEP, SAME_STEP, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED

Result = tuple[Any, float, bool, bool, dict[str, Any]]
"""Observation, reward, terminated, truncated, info."""


class ByHand:
    """A single environment that is reset as the mode says."""

    def __init__(self, env: gym.Env[Any, Any], mode: AutoresetMode) -> None:
        self.env, self.mode, self.over = env, mode, False

    def reset(self, seed: int | None = None) -> Result:
        observation, info = self.env.reset(seed=seed)
        self.over = False
        return observation, 0.0, False, False, info

    def step(self, action: np.ndarray) -> Result:
        if self.mode is NEXT_STEP and self.over:
            return self.reset()
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.over = terminated or truncated
        if self.mode is SAME_STEP and self.over:
            fresh, *_, fresh_info = self.reset()
            return fresh, reward, terminated, truncated, {**fresh_info, "final_obs": observation, "final_info": info}
        return observation, reward, terminated, truncated, info


@cache
def actions_for(name: str) -> list[np.ndarray]:
    env = gym.make(name, **QUICK)
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-0.3, 0.3, (2, *env.action_space.shape)).astype(np.float32) for _ in range(STEPS)]
    env.close()
    return actions


@cache
def stepped_by_hand(name: str, mode: AutoresetMode) -> list[list[Result | None]]:
    """What each of the two environments gives, call by call; None where a call leaves it alone."""
    both = [ByHand(gym.make(name, max_episode_steps=EPISODE, **QUICK), mode) for _ in SEEDS]
    calls: list[list[Result | None]] = [[alone.reset(seed) for alone, seed in zip(both, SEEDS, strict=True)]]
    for k, actions in enumerate(actions_for(name)):
        calls.append([alone.step(action) for alone, action in zip(both, actions, strict=True)])
        if k == 0:
            calls.append([None, both[1].reset(OTHER_SEED)])
        elif mode is DISABLED and any(alone.over for alone in both):
            calls.append([alone.reset() if alone.over else None for alone in both])
    for alone in both:
        alone.env.close()
    return calls


def stepped_as_vector(name: str, mode: AutoresetMode, **how: Any) -> list[tuple[Any, ...]]:
    """The same calls of a vector: observations, rewards, terminations, truncations, infos of each."""
    context = {"context": how["context"]} if "context" in how else {}
    usual = {"num_envs": len(SEEDS), "max_episode_steps": EPISODE, **QUICK}
    if how["vectorization_mode"] == "native":
        vector = gym.make_vec(name, autoreset_mode=mode, **usual)
    else:
        kwargs = {"autoreset_mode": mode, **context}
        vector = gym.make_vec(name, vectorization_mode=how["vectorization_mode"], vector_kwargs=kwargs, **usual)
    nothing = (np.zeros(2), np.zeros(2, dtype=bool), np.zeros(2, dtype=bool))

    def reset(seed: Any, mask: np.ndarray | None = None) -> tuple[Any, ...]:
        observation, info = vector.reset(seed=seed, options=None if mask is None else {"reset_mask": mask})
        return observation, *nothing, info

    try:
        calls = [reset(SEEDS)]
        for k, actions in enumerate(actions_for(name)):
            calls.append(vector.step(actions))
            over = calls[-1][2] | calls[-1][3]
            if k == 0:
                calls.append(reset([None, OTHER_SEED], np.array([False, True])))
            elif mode is DISABLED and over.any():
                calls.append(reset(None, over))
    finally:
        vector.close()
    return calls


def assert_same(index: int, batch: Any, single: Any) -> None:
    """Entry `index` of what a vector returned is bit for bit what the single environment returned."""
    if isinstance(single, dict):
        for key, value in single.items():
            entry = batch[key]
            if key == "final_obs":  # an array of dictionaries, not a dictionary of arrays
                assert_same(0, {name: [array] for name, array in entry[index].items()}, value)
            else:
                assert_same(index, entry, value)
            if f"_{key}" in batch:
                assert batch[f"_{key}"][index]
    else:
        np.testing.assert_array_equal(batch[index], single)
        assert not isinstance(single, np.ndarray) or batch[index].dtype == single.dtype


@pytest.fixture(params=IDS)
def same_as_by_hand(request: pytest.FixtureRequest) -> Callable[..., None]:
    def check(mode: AutoresetMode, **how: Any) -> None:
        expected = stepped_by_hand(request.param, mode)
        found = stepped_as_vector(request.param, mode, **how)
        for alone in zip(*expected[:-1], strict=True):
            assert any(result[3] for result in alone if result)  # an episode ends before the last call
        for call, singles in zip(found, expected, strict=True):
            for index, single in enumerate(singles):
                if single is not None:
                    assert_same(index, call[0], single[0])
                    assert [array[index] for array in call[1:4]] == list(single[1:4])
                    assert_same(index, call[4], single[4])

    return check


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
@pytest.mark.parametrize("kind", ["native", "sync"])
def test_in_one_process(same_as_by_hand: Callable[..., None], mode: AutoresetMode, kind: str) -> None:
    same_as_by_hand(mode, vectorization_mode=kind)


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_in_forked_processes(same_as_by_hand: Callable[..., None], mode: AutoresetMode) -> None:
    same_as_by_hand(mode, vectorization_mode="async", context="fork")


@pytest.mark.slow
@pytest.mark.parametrize(("context", "mode"), [("spawn", SAME_STEP), ("forkserver", NEXT_STEP)])
def test_in_fresh_processes(same_as_by_hand: Callable[..., None], context: str, mode: AutoresetMode) -> None:
    same_as_by_hand(mode, vectorization_mode="async", context=context)
