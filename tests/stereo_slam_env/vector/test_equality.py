"""A vector of environments gives the episodes of single ones (15 s; 100 episodes of each id are slow, 30 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)

from .same_rays import same_rays  # noqa: F401 (a fixture)

pytestmark = pytest.mark.usefixtures("same_rays")
IDS = ["StereoSlam/Drive-v0", "StereoSlam/Gaze-v0", "StereoSlam/DriveGaze-v0"]
QUICK = {"route": "right-turn", "rig": "qvga"}


def actions_of(seed, steps, shape):
    """Smooth random actions: a car that is steered at random crashes at once."""
    steps = np.random.default_rng(seed).uniform(-0.2, 0.2, (steps, *shape))
    return np.clip(np.cumsum(steps, axis=0), -1.0, 1.0).astype(np.float32)


def compare(name, seeds, steps, **arguments):
    """Drive both; the number of episodes that ended, and of those that crashed."""
    vector = gym.make_vec(name, num_envs=len(seeds), **arguments)
    actions = actions_of(0, steps, vector.action_space.shape)
    together = [vector.reset(seed=list(seeds)), *[vector.step(action) for action in actions]]
    vector.close()
    ended = crashed = 0
    with gym.make(name, **arguments) as env:
        for b, seed in enumerate(seeds):
            alone, over = env.reset(seed=seed), False
            for k, all_of_them in enumerate(together):
                if k:
                    alone = env.step(actions[k - 1, b])
                    np.testing.assert_allclose(all_of_them[1][b], alone[1], atol=1e-9)
                    assert (all_of_them[2][b], all_of_them[3][b]) == alone[2:4]
                    over = alone[2] or alone[3]
                for key, value in alone[0].items():
                    assert all_of_them[0][key].dtype == value.dtype
                    np.testing.assert_allclose(all_of_them[0][key][b], value, rtol=1e-6, atol=1e-6, err_msg=key)
                for key, value in alone[-1].items():
                    np.testing.assert_allclose(all_of_them[-1][key][b], value, rtol=1e-9, atol=1e-9, err_msg=key)
                if over:
                    ended, crashed = ended + 1, crashed + int(alone[-1]["collision"])
                    break
    return ended, crashed


@pytest.mark.parametrize(
    "arguments",
    [
        {"surroundings": "street", "max_episode_steps": 60},
        {"surroundings": "groves", "noise": "quantised", "revisit": True, "visibility": 40.0},
        {"surroundings": "field", "noise": "uvd", "max_landmarks": 100, "refill_below": 100},
        {"surroundings": "corridor", "noise": "heavy-tailed", "observe_ids": False, "perturbation": 0.0},
    ],
    ids=lambda arguments: arguments["surroundings"],
)
def test_the_episodes_are_those_of_single_environments(arguments):
    compare("StereoSlam/DriveGaze-v0", range(5, 8), 85, **QUICK, **arguments)


def test_a_scripted_drive_is_the_same():
    ended, crashed = compare("StereoSlam/Drive-v0", range(3), 80, policy="route", **QUICK)
    assert (ended, crashed) == (3, 0)


def test_a_pool_of_scenes_depends_on_the_seed_alone():
    used, new = (gym.make_vec("StereoSlam/Gaze-v0", num_envs=3, scenes=2, **QUICK) for _ in range(2))
    used.reset(seed=8)
    for key, value in used.reset(seed=1)[0].items():
        np.testing.assert_array_equal(value, new.reset(seed=1)[0][key])


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_a_hundred_episodes_are_the_same(name):
    ended, crashed = compare(name, range(100, 200), 85, **QUICK)
    if "Drive" in name:
        assert crashed > 10
    else:
        assert ended == 100
