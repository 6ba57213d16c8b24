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
        ({"speed": 3.0}, 10.0),
        ({"speed": 4.0}, 25.0),
        ({"speed": 5.0}, 35.0),
        ({"lateral": math.inf}, 35.0),
        ({"beside": -3.5}, 5.0),
        ({"beside": -1.5}, 75.0),
    ],
    ids=["3 m/s", "4 m/s", "5 m/s", "fast in bends", "oncoming lane", "beside the lane"],
)
def test_a_careless_driver_does_not_have_the_score_of_a_good_one(careless, at_most):
    returns, _ = episodes(lambda seen: follow_route(seen, **careless), max_landmarks=10)
    assert normalised_score(DRIVE, returns).mean() < at_most


def test_standing_still_costs_time():
    returns, success = episodes(lambda _: BRAKE, max_landmarks=1, max_episode_steps=300, slowest=0.0)
    assert not success.any()
    np.testing.assert_allclose(returns, -0.4 * 30.0, atol=1.0)


def test_tyres_slide_in_a_bend_that_is_driven_too_fast():
    with gym.make(DRIVE, route="straight", rig="qvga", max_landmarks=1, lane=50.0) as env:
        env.reset(seed=0)
        for action in [[1.0, 0.0]] * 25 + [[0.0, 1.0]] * 8:  # to 12 m/s, then as far as the wheels turn
            *_, info = env.step(np.array(action, dtype=np.float32))
    speed, turn = np.linalg.norm(info["truth_linear_velocity"]), abs(info["truth_angular_velocity"][1])
    assert speed * turn == pytest.approx(6.0, rel=0.05)


def test_the_task_ends_two_metres_beside_the_route():
    with gym.make(DRIVE, route="straight", max_landmarks=1) as env:
        env.reset(seed=0)
        terminated, beside = False, []
        while not terminated:
            _, _, terminated, _, info = env.step(np.array([0.0, -0.15], dtype=np.float32))
            beside.append(info["cross_track"])
    assert info["reward_collision"] == -10.0
    assert not info["collision"]
    assert not info["is_success"]
    assert beside[-2] <= 2.0 < beside[-1]


def test_metres_are_paid_less_the_farther_beside_the_route_they_are():
    with gym.make(DRIVE, route="straight", rig="qvga", max_landmarks=1) as env:
        paid = []
        for beside in (0.0, -1.0, -1.9):  # to the left, where nothing is parked
            env.reset(seed=0)
            env.unwrapped.rows.simulator.fleet.body[0, 0] = beside
            paid.append(sum(env.step(np.zeros(2, dtype=np.float32))[4]["reward_progress"] for _ in range(10)))
    np.testing.assert_allclose(np.array(paid) / paid[0], [1.0, 0.75, 1.0 - 0.95**2], atol=0.01)


def test_the_same_metres_are_paid_once():
    with gym.make(DRIVE, route="straight", rig="qvga", max_landmarks=1) as env:
        body = env.unwrapped.rows.simulator.fleet.body[0]
        env.reset(seed=0)
        for _ in range(10):
            env.step(np.zeros(2, dtype=np.float32))
        earned = []
        for back in (3.0, -3.0):  # the car is carried back 3 m and forth again
            body[2] -= back
            earned.append(env.step(np.zeros(2, dtype=np.float32))[4]["reward_progress"])
    assert earned[0] == 0.0
    assert earned[1] <= 0.1 * 2 * 0.49 + 1e-9


def test_zero_and_a_hundred_are_the_reference_returns():
    for name, (zero, best) in REFERENCE_RETURNS.items():
        assert name in gym.registry
        assert best > zero
        np.testing.assert_allclose(normalised_score(name, [zero, best]), [0.0, 100.0])
    with pytest.raises(ValueError, match=r"there is no score for 'StereoSlam/Drive', did you mean"):
        normalised_score("StereoSlam/Drive", 1.0)


def test_a_world_without_a_task_has_no_score():
    for name in ("StereoSlam/Gaze-v0", "StereoSlam/DriveGaze-v0"):
        with pytest.raises(ValueError, match=f"there is no score for '{name}'"):
            normalised_score(name, 1.0)
