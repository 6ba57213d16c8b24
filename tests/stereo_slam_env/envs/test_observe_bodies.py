"""The observation shows the moving bodies that the filter believes in, in the frame of the camera (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from filters.geometry import rotations
from stereo_slam_env.envs import BeliefObservation, ObserveBodies, SelectedKeys

from .test_snapshots import assert_goes_on_again

BELIEF = {"filter": "moving-bodies"}
WORLD = {
    **{"policy": "route", "route": "right-turn", "rig": "qvga", "sigma": 0.5, "max_landmarks": 40},
    **{"bus": "leads", "moving_cars": 2, "moving_landmarks": 20},
}
MANY_CARS = {"route": "town", "moving_cars": 6}
IDLE = np.zeros(2, dtype=np.float32)


def single(most=3, **arguments):
    env = gym.make("StereoSlam/Drive-v0", disable_env_checker=True, **{**WORLD, **arguments})
    return ObserveBodies(BeliefObservation(env, **BELIEF), most)


def many(most=3):
    return ObserveBodies(gym.make_vec("StereoSlam/Drive-v0", num_envs=3, belief=BELIEF, **WORLD), most)


def test_a_bus_ahead_is_where_it_is_with_its_velocity_and_the_rest_is_zero():
    env = single(route="straight", moving_cars=0)
    observation, info = env.reset(seed=1)
    assert not observation["bodies"].any()
    misses = []
    for _ in range(50):
        observation, _, _, _, info = env.step(IDLE)
        bodies, bus = observation["bodies"], info["truth_bodies"][0]
        assert observation in env.observation_space
        assert not bodies[1:].any()
        if bodies[0, 10]:
            R_cw = rotations.matrix(info["truth_orientation"]).T
            rear = R_cw @ (bus[1:4] - info["truth_position"]) - [0.0, 0.0, 5.0]
            misses.append([bodies[0, 2] - rear[2], bodies[0, 5] - (R_cw @ bus[8:11])[2]])
    distance, speed = np.sqrt(np.mean(np.square(misses), axis=0))
    assert len(misses) > 35
    assert distance < 0.4
    assert speed < 0.25
    env.close()


def test_rows_are_the_belief_of_the_filter_the_nearest_first():
    env = single(most=8, **MANY_CARS)
    env.reset(seed=7)
    counts = set()
    for _ in range(40):
        rows, slam = env.step(IDLE)[0]["bodies"], env.get_wrapper_attr("slam")
        bodies, R_cw = slam.bodies, rotations.matrix(slam.pose.orientation).T
        away = (bodies.positions - slam.pose.position) @ R_cw.T
        order = np.argsort(np.linalg.norm(away, axis=1))
        count = int(rows[:, 10].sum())
        counts.add(count)
        assert count == len(bodies)
        np.testing.assert_array_equal(rows[:, 10], np.arange(8) < count)
        np.testing.assert_allclose(rows[:count, :3], away[order], rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(rows[:count, 3:6], bodies.linear[order] @ R_cw.T, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(rows[:count, 6], (bodies.angular[order] @ R_cw.T)[:, 1], rtol=1e-5, atol=1e-6)
        for row, k in zip(rows[:count], order, strict=True):
            joint = 1e-6 * slam.belief("pose", f"body-{bodies.ids[k]}").covariance  # where distances are linear
            drawn = np.random.default_rng(0).multivariate_normal(np.zeros(18), joint, 4000)
            distances = np.linalg.norm(bodies.positions[k] - slam.pose.position + drawn[:, 6:9] - drawn[:, :3], axis=1)
            speeds = np.linalg.norm(bodies.linear[k] + drawn[:, 12:15], axis=1)
            turns = (bodies.angular[k] + drawn[:, 15:]) @ R_cw[1]
            sigmas = 1e3 * np.array([distances.std(), speeds.std(), turns.std()])
            np.testing.assert_allclose(row[7:10], sigmas, rtol=0.1, atol=1e-3)
    assert max(counts) > 1
    env.close()


def test_of_more_bodies_the_nearest_are_shown():
    few, all_of_them = single(most=1, **MANY_CARS), single(most=8, **MANY_CARS)
    few.reset(seed=7), all_of_them.reset(seed=7)
    for _ in range(15):
        np.testing.assert_array_equal(few.step(IDLE)[0]["bodies"], all_of_them.step(IDLE)[0]["bodies"][:1])
    few.close(), all_of_them.close()


def test_one_is_as_many():
    vector = many()
    rows = [vector.reset(seed=[2, 3, 4])[0]["bodies"]]
    rows += [vector.step(np.tile(IDLE, (3, 1)))[0]["bodies"] for _ in range(25)]
    env = single()
    for b, seed in enumerate((2, 3, 4)):
        alone = [env.reset(seed=seed)[0]["bodies"], *(env.step(IDLE)[0]["bodies"] for _ in range(25))]
        np.testing.assert_array_equal([each[b] for each in rows], alone)
    assert np.any(rows[-1])
    env.close(), vector.close()


@pytest.mark.parametrize("make", [single, many])
def test_it_goes_on_from_a_snapshot(make):
    assert_goes_on_again(make, before=12, after=10)


def test_who_does_not_show_it_does_not_read_it():
    env = SelectedKeys(single(), ["bodies", "odometry"])
    assert env.reset(seed=1)[0].keys() == {"bodies", "odometry"}
    assert SelectedKeys(single(), ["odometry"]).reset(seed=1)[0].keys() == {"odometry"}


@pytest.mark.parametrize("filter_name", ["shared-anchor", "filterpy-ekf", "dead-reckoning"])
def test_a_filter_without_bodies_gets_one_clear_line(filter_name):
    believed = BeliefObservation(gym.make("StereoSlam/Drive-v0", **WORLD), filter=filter_name)
    with pytest.raises(ValueError, match="ObserveBodies needs a filter with moving bodies") as error:
        ObserveBodies(believed)
    assert "\n" not in str(error.value)


def test_an_impossible_argument_gets_one_clear_line():
    with pytest.raises(ValueError, match="most must be"):
        single(most=0)
    with pytest.raises(ValueError, match="ObserveBodies needs 'slam'"):
        ObserveBodies(gym.make("StereoSlam/Drive-v0", **WORLD))
