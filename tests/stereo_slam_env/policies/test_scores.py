"""Driving well is the only way to earn (15 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.policies import follow_route, normalised_score
from stereo_slam_env.policies.scores import REFERENCE_RETURNS

DRIVING = ["StereoSlam/Drive-v0", "StereoSlam/DriveGaze-v0"]


def episode(env, choose, seed):
    """Return, the last info, and the values of `progress`."""
    observation, info = env.reset(seed=seed)
    total, over, progress = 0.0, False, [float(observation["progress"][0])]
    while not over:
        observation, reward, terminated, truncated, info = env.step(choose(observation))
        total, over = total + reward, terminated or truncated
        progress.append(float(observation["progress"][0]))
    return total, info, progress


@pytest.mark.parametrize("name", DRIVING)
def test_who_follows_the_route_arrives_and_has_a_score_of_100(name):
    with gym.make(name) as env:
        total, info, progress = episode(env, lambda seen: follow_route(seen, env.action_space.shape[0]), 1)
    assert info["is_success"]
    assert normalised_score(name, total) == pytest.approx(100.0, abs=5.0)
    assert (np.diff(progress) >= 0.0).all()
    assert progress[0] == 0.0
    assert progress[-1] == 1.0


@pytest.mark.parametrize("name", DRIVING)
def test_standing_still_costs_time_and_less_than_a_crash(name):
    with gym.make(name, max_landmarks=1) as env:
        brake = np.eye(env.action_space.shape[0], dtype=np.float32)[0] * -1
        total, info, _ = episode(env, lambda _: brake, 2)
        weights = env.unwrapped.options
    assert not info["is_success"]
    assert -weights.collision_weight < total < 0.0
    assert normalised_score(name, total) < 10.0


def test_the_same_metres_are_paid_once():
    with gym.make("StereoSlam/Drive-v0", route="straight", rig="qvga", max_landmarks=1) as env:
        body = env.unwrapped._rows.simulator.fleet.body[0]
        env.reset(seed=0)
        for _ in range(10):
            env.step(np.zeros(2, dtype=np.float32))
        earned = []
        for back in (3.0, -3.0):  # the car is carried back 3 m and forth again
            body[2] -= back
            earned.append(env.step(np.zeros(2, dtype=np.float32))[4]["reward_progress"])
    assert earned[0] == 0.0
    assert earned[1] <= 0.1 * 2 * 0.49 + 1e-9


def test_random_is_zero_and_the_best_is_a_hundred():
    for name, (random, best) in REFERENCE_RETURNS.items():
        assert name in gym.registry
        assert best > random
        np.testing.assert_allclose(normalised_score(name, [random, best]), [0.0, 100.0])
    with pytest.raises(ValueError, match=r"there is no score for 'StereoSlam/Drive', did you mean"):
        normalised_score("StereoSlam/Drive", 1.0)
