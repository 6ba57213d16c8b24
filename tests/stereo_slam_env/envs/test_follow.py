"""The car keeps its distance by what the filter believes of the bus ahead, and cannot do so blindly (40 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import BeliefObservation, FollowLeader, follow_bus

ID = "StereoSlam/Follow-v0"
SEEDS = (1, 2, 6)
"""In which the bus stands for a while."""


def blindly(observation):
    """4 m/s."""
    return np.clip((4.0 - observation["car"][:1]) / 0.3, -1.0, 1.0).astype(np.float32)


def drive(choose, steps=200):
    """Returns and last infos of a drive with each seed."""
    fewer = {"max_landmarks": 25, "moving_landmarks": 20}
    vector = gym.make_vec(ID, num_envs=len(SEEDS), max_episode_steps=steps, **fewer)
    observation, _ = vector.reset(seed=list(SEEDS))
    total, going, info = np.zeros(len(SEEDS)), np.ones(len(SEEDS), dtype=bool), {}
    while going.any():
        actions = np.array([choose({key: values[b] for key, values in observation.items()}) for b in range(len(SEEDS))])
        observation, rewards, terminated, truncated, info = vector.advance(actions, going)
        terms = sum(values for key, values in info.items() if key.startswith("reward_"))
        np.testing.assert_allclose(rewards[going], terms[going])
        total += np.where(going, rewards, 0.0)
        going &= ~(terminated | truncated)
    vector.close()
    return total, info


def test_the_rule_keeps_the_gap_and_who_sees_nothing_does_not():
    by_belief, info = drive(follow_bus)
    assert info["is_success"].all()
    assert not info["collision"].any()
    assert (by_belief > 16.0).all()
    blind, info = drive(blindly)
    assert info["collision"].sum() >= 2
    assert blind.mean() < 0.4 * by_belief.mean()
    assert not info["is_success"][info["collision"]].any()


def test_who_stays_behind_earns_nothing():
    behind, info = drive(lambda _: np.array([-1.0], np.float32), steps=60)
    assert (np.abs(behind) < 1.0).all()
    assert not info["is_success"].any()
    assert not info["failed"].any()


def test_the_gap_is_from_bumper_to_bumper_and_paid_by_its_own_formula():
    with gym.make(ID, disable_env_checker=True, headway=1.0, standstill=6.0, gap_weight=2.0) as env:
        env.reset(seed=1)
        for _ in range(12):
            observation, _, _, _, info = env.step(np.array([0.2], np.float32))
            away = np.hypot(*(info["truth_bodies"][0, 1:4] - info["truth_position"])[[0, 2]])
            assert info["gap"] == pytest.approx(away - 5.0 - (2.1 - 0.25))
            wanted = 6.0 + observation["car"][0]
            paid = 0.1 * 2.0 * max(1.0 - abs(info["gap"] - wanted) / wanted, 0.0)
            assert info["reward_gap"] == pytest.approx(paid, rel=1e-5)


def test_a_bus_that_stops_and_goes_has_speeds_of_its_own():
    arguments = {"route": "straight", "moving_landmarks": 4, "rig": "qvga", "slowest": 0.0, "perturbation": 0.0}
    profiles = []
    for seed in (1, 2):
        env = gym.make("StereoSlam/Drive-v0", disable_env_checker=True, bus="stops-and-goes", **arguments)
        _, info = env.reset(seed=seed)
        ahead, speeds = info["truth_bodies"][0, 3] - info["truth_position"][2], []
        for _ in range(150):
            *_, info = env.step(np.array([-1.0, 0.0], np.float32))
            speeds.append(np.linalg.norm(info["truth_bodies"][0, 8:11]))
        assert ahead == pytest.approx(20.0, abs=0.1)
        changes = np.diff(speeds) / 0.1
        assert changes.min() > -2.6
        assert changes.max() < 1.6
        assert max(speeds) <= 8.0
        profiles.append(speeds)
        env.close()
    assert min(map(min, profiles)) < 0.01
    assert not np.allclose(*profiles)


def test_the_rule_follows_the_nearest_body_ahead_and_slows_down_where_there_is_none():
    bodies = np.zeros((4, 11))
    assert -1.0 < follow_bus({"bodies": bodies, "car": [5.0, 0.0]})[0] < 0.0
    bodies[0, [2, 10]] = -5.0, 1.0  # behind
    bodies[1, [2, 5, 10]] = 4.0 + 1.5 * 5.0 + 1.85, 5.0, 1.0
    assert follow_bus({"bodies": bodies, "car": [5.0, 0.0]})[0] == pytest.approx(0.0, abs=1e-6)
    bodies[1, 7] = 2.0  # it may be nearer
    assert follow_bus({"bodies": bodies, "car": [5.0, 0.0]})[0] < -0.3


@pytest.mark.parametrize(
    ("name", "arguments"), [("Drive", {"policy": "route"}), ("Gaze", {})], ids=["a scripted drive", "a gaze"]
)
def test_a_script_would_run_into_such_a_bus(name, arguments):
    with pytest.raises(ValueError, match="bus must not be 'stops-and-goes' where a script drives"):
        gym.make(f"StereoSlam/{name}-v0", bus="stops-and-goes", **arguments)


def test_at_the_level_hard_less_of_the_bus_is_tracked():
    tracked = {level: gym.make(ID, level=level).unwrapped.options.moving_landmarks for level in ("easy", "hard")}
    assert tracked == {"easy": 40, "hard": 10}
    assert gym.make(ID, level="hard", moving_landmarks=5).unwrapped.options.moving_landmarks == 5


def test_without_a_bus_that_is_seen_there_is_nothing_to_follow():
    for arguments in ({"bus": "stops-and-goes"}, {"moving_cars": 1, "moving_landmarks": 5}):
        with pytest.raises(ValueError, match="FollowLeader needs a bus that is seen"):
            FollowLeader(BeliefObservation(gym.make("StereoSlam/Drive-v0", **arguments)))
    with pytest.raises(ValueError, match="ObserveBodies needs a filter with moving bodies"):
        gym.make(ID, filter="shared-anchor")
