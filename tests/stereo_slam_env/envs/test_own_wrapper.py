"""A stranger's wrapper, that of the manual: one class for one environment, a vector and rows (10 s)."""

import json
import pickle
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from stereo_slam_env.envs import RowsWrapper, restore, snapshot

PAGE = Path(__file__).parents[3] / "docs/wrappers.md"
CODE = next(
    code for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL) if "class" in code
)
exec(compile(re.search(r"class SteadyHead.*?truncated\n(?=\n)", CODE, re.DOTALL)[0], str(PAGE), "exec"))
TASK = next(
    code
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    if "TaskEnv" in code
)
ID, STEPS, SEED = "StereoSlam/Gaze-v0", 12, 5
SteadyHead = globals()["SteadyHead"]


def actions_of(seed):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (STEPS, 2)).astype(np.float32)


def rewards_of(env, actions):
    return [env.step(action)[1] for action in actions]


def test_one_and_many_give_the_same_bits_and_it_does_what_it_says():
    one, plain = SteadyHead(gym.make(ID), weight=0.2), gym.make(ID)
    many = SteadyHead(gym.make_vec(ID, num_envs=3), weight=0.2)
    assert type(many) is type(gym.make_vec(ID))
    actions = np.stack([actions_of(SEED + b) for b in range(3)], axis=1)
    many.reset(seed=SEED)
    paid = np.array(rewards_of(many, actions))
    for b in range(3):
        one.reset(seed=SEED + b)
        np.testing.assert_array_equal(rewards_of(one, actions[:, b]), paid[:, b])
    plain.reset(seed=SEED)
    without = np.array(rewards_of(plain, actions[:, 0]))
    steps = np.abs(np.diff(actions[:, 0].astype(float), axis=0, prepend=0.0)).sum(axis=1)
    np.testing.assert_allclose(paid[:, 0], without - 0.2 * steps, atol=1e-6)


def test_a_snapshot_keeps_its_attributes_without_being_told():
    env, actions = SteadyHead(gym.make(ID)), actions_of(0)
    env.reset(seed=SEED)
    rewards_of(env, actions[:5])
    state = snapshot(env)
    first = rewards_of(env, actions[5:])
    restore(env, state)
    assert rewards_of(env, actions[5:]) == first


def test_it_is_a_wrapper_of_gymnasium():
    env = SteadyHead(gym.make(ID), 0.3)
    assert isinstance(env, gym.Wrapper)
    assert isinstance(env, SteadyHead)
    assert isinstance(env, RowsWrapper)
    assert str(env).startswith("<SteadyHead<")
    (spec,) = env.spec.additional_wrappers
    assert spec.kwargs == {"weight": 0.3}
    assert "SteadyHead" in json.loads(env.spec.to_json())["additional_wrappers"][0]["name"]
    assert env.get_wrapper_attr("arguments") == {"weight": 0.3}


def test_wrappers_of_the_package_survive_pickle_and_are_made_again_from_their_spec():
    from stereo_slam_env.envs import BeliefObservation, TrueError

    env = TrueError(BeliefObservation(gym.make(ID)), weight=2.0)
    for again in (pickle.loads(pickle.dumps(env)), gym.make(env.spec)):
        assert isinstance(again, TrueError)
        assert again.arguments == {"weight": 2.0, "keep_reward": False}
        assert again.env.arguments == env.env.arguments


@pytest.mark.parametrize(
    ("wrong", "kind", "words"),
    [
        (lambda: SteadyHead(gym.make(ID), wieght=1.0), TypeError, "SteadyHead: .*wieght"),
        (lambda: SteadyHead(gym.make_vec(ID, num_envs=2, vectorization_mode="sync")), ValueError, "a native vector"),
    ],
)
def test_wrong_use_is_told_in_a_line(wrong, kind, words):
    with pytest.raises(kind, match=words):
        wrong()


def test_a_task_of_one_s_own_is_one_environment_and_many_with_levels_and_arguments_of_its_wrappers():
    exec(compile(TASK, str(PAGE), "exec"), globals())
    check_env(gym.make("Mine/Steady-v0").unwrapped, skip_render_check=True)
    one, many = (
        gym.make("Mine/Steady-v0", keep_reward=True),
        gym.make_vec("Mine/Steady-v0", num_envs=2, keep_reward=True),
    )
    seen, info = one.reset(seed=SEED)
    rows, _ = many.reset(seed=SEED)
    assert set(seen) == {"belief_sigmas", "head", "panorama"}
    assert {"reward_error", "truth_position"} <= set(info)
    for action in actions_of(SEED):
        seen, reward, *_ = one.step(action)
        rows, rewards, *_ = many.step(np.stack([action, action]))
        assert reward == rewards[0]
        np.testing.assert_array_equal(seen["panorama"], rows["panorama"][0])
    assert gym.make("Mine/Steady-v0", level="hard").unwrapped.options.visibility == 25.0
    with pytest.raises(TypeError, match="unexpected keyword argument 'wieght'"):
        gym.make("Mine/Steady-v0", wieght=0.5)
    with pytest.raises(ValueError, match="weight is an argument of TrueError and SteadyHead: set it in the parts"):
        gym.make("Mine/Steady-v0", weight=0.5)
