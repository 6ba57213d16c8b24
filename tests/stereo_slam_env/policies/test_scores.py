"""Driving well is the only way to earn: what careless drivers get (20 s)."""

import math

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import follow_route
from stereo_slam_env.policies import normalised_score
from stereo_slam_env.policies.policy_rows import REFERENCE_RETURNS

DRIVE = "StereoSlam/Drive-v0"
BRAKE = np.array([-1.0, 0.0], dtype=np.float32)
SCENES = 6


def episodes(choose, **options):
    """Returns and successes of the episodes of some seeds, each on a route of its own."""
    vector = gym.make_vec(DRIVE, num_envs=SCENES, **options)
    observation, _ = vector.reset(seed=50)
    returns, success = np.zeros(SCENES), np.zeros(SCENES, dtype=bool)
    going = np.ones(SCENES, dtype=bool)
    while going.any():
        seen = [{key: observation[key][b] for key in ("car", "route")} for b in range(SCENES)]
        observation, rewards, terminated, truncated, info = vector.step(np.array([choose(each) for each in seen]))
        returns += np.where(going, rewards, 0.0)
        success |= going & info["is_success"]
        going &= ~(terminated | truncated)
    vector.close()
    return returns, success


def test_who_follows_the_route_arrives_and_the_scenes_matter():
    returns, success = episodes(follow_route)
    assert success.all()
    assert normalised_score(DRIVE, returns).mean() == pytest.approx(100.0, abs=15.0)
    assert returns.std() > 2.0


@pytest.mark.parametrize(
    ("careless", "at_most"),
    [
        ({"speed": 4.0}, 25.0),
        ({"speed": 5.0}, 35.0),
        ({"lateral": math.inf}, 35.0),
        ({"beside": -3.5}, 5.0),
        ({"beside": -1.5}, 75.0),
    ],
    ids=["4 m/s", "5 m/s", "fast in bends", "oncoming lane", "beside the lane"],
)
def test_a_careless_driver_does_not_have_the_score_of_a_good_one(careless, at_most):
    returns, _ = episodes(lambda seen: follow_route(seen, **careless), max_landmarks=10)
    assert normalised_score(DRIVE, returns).mean() < at_most


def test_standing_still_costs_time():
    returns, success = episodes(lambda _: BRAKE, max_landmarks=1, max_episode_steps=300, slowest=0.0)
    assert not success.any()
    np.testing.assert_allclose(returns, -0.4 * 30.0, atol=1.0)


def test_zero_and_a_hundred_are_the_reference_returns():
    for name, (zero, best) in REFERENCE_RETURNS.items():
        assert name in gym.registry
        assert best > zero
        np.testing.assert_allclose(normalised_score(name, [zero, best]), [0.0, 100.0])
    for name, near in (("Drive", ", did you mean"), ("Gaze-v0", ""), ("DriveGaze-v0", "")):
        with pytest.raises(ValueError, match=f"there is no score for 'StereoSlam/{name}'{near}"):
            normalised_score(f"StereoSlam/{name}", 1.0)
