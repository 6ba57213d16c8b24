"""One Box instead of a Dict, by an argument: for what knows no Dict (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import SelectedKeys

TASKS = [f"StereoSlam/{name}-v0" for name in ("ActiveGaze", "Explore", "Revisit", "ClosedLoop", "Branches", "Follow")]


@pytest.mark.parametrize("name", TASKS)
def test_it_holds_what_the_keys_hold_one_and_many(name):
    mapping, flat = gym.make(name), gym.make(name, observation="flat")
    vector = gym.make_vec(name, num_envs=2, observation="flat")
    action = np.zeros(flat.action_space.shape, dtype=flat.action_space.dtype)
    pairs = [(mapping.reset(seed=3)[0], flat.reset(seed=3)[0], vector.reset(seed=3)[0][0])]
    pairs.append((mapping.step(action)[0], flat.step(action)[0], vector.step(np.stack([action, action]))[0][0]))
    for seen, one, many in pairs:
        np.testing.assert_array_equal(one, gym.spaces.flatten(mapping.observation_space, seen))
        np.testing.assert_array_equal(many, one)
        assert flat.observation_space.contains(one)
    assert flat.observation_space == gym.spaces.flatten_space(mapping.observation_space)


def test_a_native_vector_takes_it_with_keys_of_its_own():
    vector = gym.make_vec("StereoSlam/Drive-v0", num_envs=2, observation="flat", keys=["car", "route"])
    assert vector.reset(seed=0)[0].shape == vector.observation_space.shape == (2, 12)


def test_what_cannot_be_in_a_box_is_refused():
    with pytest.raises(ValueError, match="observation must be one of 'dict', 'flat', got 'box'"):
        gym.make("StereoSlam/Branches-v0", observation="box")
    with pytest.raises(ValueError, match="has no key 'nothing'"):
        SelectedKeys(gym.make("StereoSlam/Drive-v0"), ["nothing"], "flat")
