"""The car goes where the filter believes it is (10 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import drive_slowly, follow_route


def drive(choose, seed=1, route="town", **arguments):
    """Return, the last info, and the largest distance from the route, m."""
    given = {"route": route, "rig": "qvga", **arguments.pop("arguments", {})}
    with gym.make("StereoSlam/ClosedLoop-v0", disable_env_checker=True, arguments=given, **arguments) as env:
        observation, info = env.reset(seed=seed)
        total, off, over = 0.0, 0.0, False
        while not over:
            observation, reward, terminated, truncated, info = env.step(choose(observation))
            terms = sum(value for key, value in info.items() if key.startswith("reward_"))
            assert reward == pytest.approx(terms)
            total, off, over = total + reward, max(off, info["cross_track"]), terminated or truncated
    return total, info, off


def test_with_a_filter_the_car_arrives_and_earns_it():
    total, info, off = drive(follow_route)
    assert info["is_success"]
    assert off < 1.0
    assert total > 15.0


def test_with_dead_reckoning_it_leaves_its_route_and_pays_for_it():
    noisy = {"odometry_sigma_angular": 0.2}
    total, info, off = drive(drive_slowly, filter="dead-reckoning", arguments=noisy)
    assert not info["is_success"]
    assert info["reward_collision"] == -10.0
    assert info["reward_goal"] == 0.0
    assert off > 1.0
    assert total < 20.0


def test_a_late_estimate_needs_a_slow_driver():
    fast, info, _ = drive(follow_route, latency=5)
    assert not info["is_success"]
    slow, info, _ = drive(drive_slowly, latency=5, route="right-turn", slowest=0.0)
    assert info["is_success"]
    assert slow > 0.0 > fast


def test_the_route_is_that_of_the_belief_some_frames_ago():
    made = [
        gym.make("StereoSlam/ClosedLoop-v0", disable_env_checker=True, latency=latency, arguments={"rig": "qvga"})
        for latency in (0, 3)
    ]
    seen = []
    for env in made:
        observations = [env.reset(seed=4)[0]] + [env.step(np.array([0.2, 0.1], np.float32))[0] for _ in range(6)]
        seen.append([observation["route"] for observation in observations])
        env.close()
    np.testing.assert_array_equal(seen[1][3:], seen[0][:-3])
    np.testing.assert_array_equal(seen[1][:3], [seen[0][0]] * 3)


@pytest.mark.parametrize(("level", "latency"), [("easy", 1), ("normal", 3), ("hard", 4)])
def test_the_harder_the_level_the_later_is_the_estimate(level, latency):
    def seen(**arguments):
        given = {"level": level, "arguments": {"rig": "qvga"}, **arguments}
        with gym.make("StereoSlam/ClosedLoop-v0", disable_env_checker=True, **given) as env:
            env.reset(seed=4)
            return [env.step(np.array([0.2, 0.1], np.float32))[0]["route"] for _ in range(6)]

    usual = seen()
    np.testing.assert_array_equal(usual, seen(latency=latency))
    assert not np.array_equal(usual, seen(latency=latency + 1))


def test_who_drives_too_slowly_fails_and_whose_mean_speed_is_six_metres_a_second_does_not():
    slow, info, _ = drive(drive_slowly, route="straight")
    assert info["failed"]
    assert not info["collision"]
    assert info["time"] == pytest.approx(97.5 / 6.0, abs=0.2)
    fast, info, _ = drive(lambda seen: follow_route(seen, speed=7.0), route="straight")
    assert info["is_success"]
    assert slow < 0.0 < 10.0 < fast


def test_a_jerky_driver_pays_for_it():
    smooth, *_ = drive(lambda seen: follow_route(seen, speed=8.0), route="straight")
    side = [1.0]

    def jerky(seen):
        side[0] = -side[0]
        return follow_route(seen, speed=8.0) + np.array([side[0], 0.0], np.float32)

    rough, info, _ = drive(jerky, route="straight")
    assert info["is_success"]
    assert rough < smooth - 10.0
