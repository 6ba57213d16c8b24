"""A curriculum goes on when it is earned."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.tasks import LEVELS, Curriculum

STOP = np.array([0, 0, 1, 0, 0], np.float32)
MADE = {"arguments": {"route": "right-turn"}, "disable_env_checker": True}


def levels_of(goal, episodes, seed=0, **arguments):
    """Level at every reset, of an agent that stops at once, and the first entry of each car's view."""
    env = Curriculum(gym.make("StereoSlam/Explore-v0", goal=goal, **MADE), **arguments)
    levels, views = [], []
    for number in range(episodes):
        observation, info = env.reset(seed=seed if number == 0 else None)
        assert info["level"] == list(LEVELS).index(env.level)
        assert env.unwrapped.options.sigma == LEVELS[env.level].get("sigma", 1.0)
        levels.append(env.level)
        views.append(float(observation["belief_sigmas"][0]))
        env.step(STOP)
    env.close()
    return levels, views


def test_who_succeeds_goes_on_to_the_last_level():
    levels, views = levels_of(1e-9, 7, window=2, rate=1.0)  # one landmark on the map is enough
    assert levels[:2] == ["easy", "easy"]
    assert levels == sorted(levels, key=list(LEVELS).index)
    assert "normal" in levels
    assert levels_of(1e-9, 7, window=2, rate=1.0) == (levels, views)  # scenes and levels by the seed


def test_who_does_not_stays():
    assert levels_of(1.0, 4, window=2, rate=0.5)[0] == ["easy"] * 4


def test_episodes_that_were_not_ended_do_not_count():
    env = Curriculum(gym.make("StereoSlam/Explore-v0", goal=1e-9, **MADE), window=1)
    for _ in range(3):
        env.reset(seed=1)
        env.step(np.zeros(5, np.float32))
    assert env.level == "easy"
    env.close()


def test_an_unknown_level_is_refused():
    with pytest.raises(ValueError, match=r"level must be .*, got 'harder'"):
        Curriculum(gym.make("StereoSlam/Explore-v0", **MADE), levels=("easy", "harder"))
