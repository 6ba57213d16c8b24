"""Neither new roads alone nor known ones alone make a map that is true (30 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.envs import explore_and_close, restore, snapshot, to_new_roads
from stereo_slam_env.envs.branches import DRIVEN, EXISTS, TO_NEW, TO_START
from stereo_slam_env.policies.policy_rows import Oracle
from stereo_slam_env.world.street_grid import RIGHT, STRAIGHT

NAME = "StereoSlam/Branches-v0"


def share_of_map(env, roads):
    """Share of the map that so many roads have, computed anew."""
    landmarks, truth = env.get_wrapper_attr("slam").landmarks, env.unwrapped.landmark_truth().positions
    errors = np.linalg.norm(landmarks.positions - truth[landmarks.ids], axis=1)
    whole = len(truth) * min(roads / env.unwrapped.route.streets.count, 1.0)
    return np.clip(1.0 - errors**2, 0.0, None).sum() / whole


def test_the_chosen_roads_are_driven_and_paid_for_by_the_truth():
    with gym.make(NAME, disable_env_checker=True, roads=4, goal=0.9) as env:
        observation, info = env.reset(seed=3)
        first, total, seen = info["mapped"], 0.0, [observation]
        for _ in range(4):
            assert not info["is_success"]
            observation, reward, terminated, _, info = env.step(RIGHT)
            assert info["mapped"] == pytest.approx(share_of_map(env, 4))
            total += reward
            seen.append(observation)
        np.testing.assert_allclose(
            info["truth_position"], 0.0, atol=3.0
        )  # round a block, beside its path as drivers are
    assert terminated
    assert (info["roads"], info["collision"]) == (4, False)
    assert total == pytest.approx(100.0 * (info["mapped"] - first))
    assert [float(each["roads_left"][0]) for each in seen] == [4, 3, 2, 1, 0]
    assert seen[0]["branches"][STRAIGHT, [EXISTS, DRIVEN, TO_NEW]].tolist() == [1, 0, 0]
    assert [seen[k]["branches"][RIGHT, TO_START] for k in range(4)] == [3, 2, 1, 0]
    assert seen[4]["branches"][RIGHT, [DRIVEN, TO_NEW]].tolist() == [1, 1]


def test_who_explores_and_closes_loops_has_more_than_who_does_only_one():
    """Always straight on, once round one block and again, and always to new roads, beside the rule; 5 scenes."""
    rules = {"straight": lambda _: STRAIGHT, "block": lambda _: RIGHT, "new": to_new_roads, "rule": explore_and_close}
    scenes = 5
    vector = gym.make_vec(NAME, num_envs=scenes * len(rules))
    observation, _ = vector.reset(seed=list(range(60, 60 + scenes)) * len(rules))
    returns, over = np.zeros(vector.num_envs), np.zeros(vector.num_envs, dtype=bool)
    while not over.any():
        rows = [{key: values[b] for key, values in observation.items()} for b in range(vector.num_envs)]
        chosen = [rule(rows[k * scenes + b]) for k, rule in enumerate(rules.values()) for b in range(scenes)]
        observation, rewards, over, _, info = vector.step(np.array(chosen))
        returns += rewards
    vector.close()
    assert over.all()
    means = dict(zip(rules, returns.reshape(-1, scenes).mean(axis=1), strict=True))
    roads = dict(zip(rules, info["roads"].reshape(-1, scenes).mean(axis=1), strict=True))
    assert means["rule"] > max(means["straight"], means["block"], means["new"]) + 4.0
    assert roads["block"] < roads["rule"] < roads["new"]


def test_a_choice_can_be_tried_and_taken_back():
    vector = gym.make_vec(NAME, num_envs=2, roads=2)
    vector.reset(seed=[7, 8])
    before = snapshot(vector)
    tried = [vector.step(np.full(2, choice))[1] for choice in range(3) if restore(vector, before) is None]
    restore(vector, before)
    best = Oracle(vector.rows, depth=1).act(np.ones(2, dtype=bool))
    np.testing.assert_array_equal(best, np.argmax(tried, axis=0))
    np.testing.assert_array_equal(vector.step(best)[1], np.max(tried, axis=0))
    vector.close()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"roads": 0}, "roads must be"),
        ({"accuracy": 0.0}, "accuracy must be"),
        ({"arguments": {"route": "town"}}, "the route must lead through streets, as 'random-grid' does, and 'town'"),
    ],
)
def test_an_impossible_argument_gets_one_clear_line(wrong, message):
    with pytest.raises(ValueError, match=message):
        gym.make(NAME, **wrong)
