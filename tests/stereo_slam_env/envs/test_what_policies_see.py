"""What tasks show to policies, take from them, and say of themselves (60 s)."""

import dataclasses
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.common import PassiveEnvChecker

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import follow_bus, follow_route
from stereo_slam_env.envs.core_rows import CoreRows
from stereo_slam_env.policies import normalised_score
from stereo_slam_env.policies.policy_rows import REFERENCE_RETURNS

from .test_tasks import QUICK, made

WORLDS = ("StereoSlam/Drive-v0", "StereoSlam/Gaze-v0", "StereoSlam/DriveGaze-v0")
DISCRETE = ("StereoSlam/ActiveGaze-v0", "StereoSlam/Branches-v0", "StereoSlam/Revisit-v0")


def driven(name, steps=4, **arguments):
    """Observations and infos of a few steps without accidents."""
    env = made(name, **arguments)
    observation, info = env.reset(seed=3)
    seen = [(observation, info)]
    for step in range(steps):
        if isinstance(env.action_space, gym.spaces.Discrete):
            action = 1 if name == "StereoSlam/Revisit-v0" else step % 2
        elif name == "StereoSlam/Follow-v0":
            action = follow_bus(observation)
        else:
            action = follow_route(observation, env.action_space.shape[0], speed=5.0)
        observation, _, terminated, _, info = env.step(action)
        seen.append((observation, info))
        if terminated:
            break
    env.close()
    return seen


@pytest.fixture
def false_truth(monkeypatch):
    """The world says of true places, progress and the route ahead what is not so."""
    truth, show = CoreRows.landmark_truth, CoreRows.observe

    def elsewhere(self, b):
        told = truth(self, b)
        return dataclasses.replace(told, positions=told.positions + np.array([40.0, 0.0, 0.0]))

    def look(self):
        observation, info = show(self)
        return {key: 0.0 * x if key in ("progress", "route") else x for key, x in observation.items()}, info

    monkeypatch.setattr(CoreRows, "landmark_truth", elsewhere)
    monkeypatch.setattr(CoreRows, "observe", look)


@pytest.fixture(scope="module")
def honest():
    return {name: driven(name) for name in QUICK}


@pytest.mark.parametrize("name", QUICK)
@pytest.mark.usefixtures("false_truth")
def test_no_key_of_the_observation_is_made_from_the_truth(name, honest):
    for (seen, _), (true, _) in zip(driven(name), honest[name], strict=True):
        for key, value in true.items():
            np.testing.assert_array_equal(seen[key], value, err_msg=key)


@pytest.mark.parametrize(("name", "key"), [("StereoSlam/Explore-v0", "coverage"), ("StereoSlam/Branches-v0", "mapped")])
def test_what_is_claimed_is_shown_and_what_is_true_told(name, key, request):
    honest = driven(name, steps=40)
    shown, told = (np.array(x) for x in zip(*((seen[key][0], info[key]) for seen, info in honest), strict=True))
    assert told[-1] > 0.0
    np.testing.assert_allclose(shown, told, atol=0.1)  # a consistent filter claims what is about so
    request.getfixturevalue("false_truth")
    assert driven(name, steps=40)[-1][1][key] < 0.1 * told[-1]


def test_a_turned_head_does_not_turn_the_route_that_is_shown():
    """The estimate is one of the camera; the route is that in front of the car."""
    env = made("StereoSlam/Explore-v0")
    seen, _ = env.reset(seed=3)
    action = np.array([0.0, 0.0, 0.0, 1.0, 0.5])
    for _ in range(8):
        seen, _, _, _, info = env.step(action)
    true = env.unwrapped.rows.world.observe()[0]["route"][0]
    assert abs(seen["head"][0]) > 0.3
    assert np.isfinite(info["truth_position"]).all()
    np.testing.assert_allclose(seen["route"], true, atol=0.2)


def test_who_leaves_the_lane_has_not_explored():
    env = made("StereoSlam/Explore-v0", goal=1e-3, accuracy=5.0)
    env.reset(seed=3)
    action, over = np.array([1.0, 1.0, 0.0, 0.0, 0.0]), False
    while not over:
        *_, over, _, info = env.step(action)
    assert info["failed"]
    assert not info["collision"]
    assert info["coverage"] > 1e-3
    assert not info["is_success"]


@pytest.mark.parametrize("wrong", [999, -1, 1.0, 1.5, float("nan"), "left", None, [1], True])
@pytest.mark.parametrize("name", DISCRETE)
def test_a_choice_that_is_none_is_refused_by_one_and_by_many(name, wrong):
    arguments = {**QUICK[name]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env, vector = made(name), gym.make_vec(name, num_envs=1, **arguments)
        for each, action, said in ((env, wrong, "action must be a whole number"), (vector, [wrong], "actions must be")):
            each.reset(seed=0)
            with pytest.raises(ValueError, match=f"{said}.* from 0 to") as error:
                each.step(action)
            assert "\n" not in str(error.value)
            each.step(each.action_space.sample())  # nothing has changed
            each.close()


def test_a_stop_that_is_no_number_is_refused():
    env = made("StereoSlam/Explore-v0")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be finite"):
        env.step(np.array([0.0, 0.0, np.nan, 0.0, 0.0]))


@pytest.mark.parametrize("name", QUICK)
def test_a_task_takes_arguments_of_its_world_beside_its_own(name):
    beside = made(name, sigma=0.5)
    inside = made(name, arguments={**QUICK[name].get("arguments", {}), "sigma": 0.5})
    assert beside.unwrapped.options.sigma == inside.unwrapped.options.sigma == 0.5
    assert beside.unwrapped.options == inside.unwrapped.options
    vector = gym.make_vec(name, num_envs=1, **{**QUICK[name], "sigma": 0.5})
    assert vector.options.sigma == 0.5
    with pytest.raises(TypeError, match="did you mean 'sigma'"):
        made(name, sigmma=0.5)
    with pytest.raises(ValueError, match="sigma is given twice"):
        made(name, sigma=0.5, arguments={"sigma": 0.5})


@pytest.mark.parametrize("name", [*WORLDS, *QUICK])
def test_one_time_limit_and_one_checker(name):
    env, kinds = gym.make(name), []
    while env is not env.unwrapped:
        kinds.append(type(env))
        env = env.env
    assert kinds.count(gym.wrappers.TimeLimit) == kinds.count(PassiveEnvChecker) == 1


@pytest.mark.parametrize("name", [*WORLDS, *QUICK])
def test_the_seed_of_a_reset_is_told(name):
    env = gym.make(name, **QUICK.get(name, {}))
    env.reset(seed=5)
    assert env.np_random_seed == 5
    env.reset()
    assert env.np_random_seed == 5
    vector = gym.make_vec(name, num_envs=2, **QUICK.get(name, {}))
    vector.reset(seed=5)
    vector.reset()
    assert vector.unwrapped.np_random_seed == (5, 6)


def test_the_best_return_known_is_the_reward_threshold():
    for name, (_, best) in REFERENCE_RETURNS.items():
        assert gym.spec(name).reward_threshold == best
        assert normalised_score(name, best) == pytest.approx(100.0)
        assert gym.make(name.replace("-v0", "-hard-v0")).spec.reward_threshold is None if name in QUICK else True
