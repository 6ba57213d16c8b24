"""A choice of speed and gaze holds for a second, and a script steers (5 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import follow_route

WORLD = {"arguments": {"route": "right-turn", "rig": "qvga"}}
CHOICES = {"speeds": [3.0, 6.0], "pans": [-0.5, 0.5], "hold": 4}
NUMBER = {(3.0, -0.5): 1, (3.0, 0.5): 2, (6.0, -0.5): 3, (6.0, 0.5): 4}


def by_hand(seed, decisions):
    """The return of each decision where an agent follows the route itself."""
    with gym.make("StereoSlam/Explore-v0", disable_env_checker=True, **WORLD) as env:
        observation, info = env.reset(seed=seed)
        for speed, pan in decisions:
            total = 0.0
            for _ in range(4):
                action = follow_route(observation, 5, speed=speed)
                action[3] = pan
                observation, reward, _, _, info = env.step(action)
                total += reward
            yield total, observation, info


@pytest.mark.parametrize("together", [False, True], ids=["one", "rows"])
def test_a_choice_is_what_an_agent_would_do_that_follows_the_route(together):
    decisions, arguments = list(NUMBER), {**WORLD, "choices": CHOICES}
    expected = list(by_hand(7, decisions))
    if together:
        env = gym.make_vec("StereoSlam/Explore-v0", num_envs=2, **arguments)
        env.reset(seed=6)
    else:
        env = gym.make("StereoSlam/Explore-v0", disable_env_checker=True, **arguments)
        env.reset(seed=7)
    b = (1,) if together else ()
    for decision, (total, shown, told) in zip(decisions, expected, strict=True):
        number = NUMBER[decision]
        observation, reward, terminated, _, info = env.step(np.full(2, number) if together else number)
        assert np.asarray(reward)[b] == pytest.approx(total)
        assert not np.any(terminated)
        for key, value in shown.items():
            np.testing.assert_array_equal(np.asarray(observation[key])[b], value, err_msg=key)
        assert np.asarray(info["path_length"])[b] == told["path_length"]
    env.close()


def test_the_choice_0_stops_at_once():
    with gym.make("StereoSlam/Explore-v0", disable_env_checker=True, **WORLD, choices=CHOICES) as env:
        env.reset(seed=7)
        _, reward, terminated, truncated, info = env.step(0)
    assert terminated
    assert not truncated
    assert info["time"] == pytest.approx(0.1)
    assert -0.1 < reward < 1.0


@pytest.mark.parametrize(("wrong", "message"), [({"hold": 0}, "hold"), ({"speeds": [0.0]}, "speeds")])
def test_impossible_choices_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        gym.make("StereoSlam/Explore-v0", disable_env_checker=True, **WORLD, choices=wrong)
