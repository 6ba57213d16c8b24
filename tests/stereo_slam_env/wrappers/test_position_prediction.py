"""An agent that says where it is: paid for by the truth, in one environment and in many."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.wrappers import BeliefObservation, PositionPrediction, TrueError, restore, snapshot

QUICK = {"route": "right-turn", "max_landmarks": 8}
BELIEF = {"options": {"drop_unseen": False, "motion": "velocity-driven"}}
AHEAD = np.zeros(2, dtype=np.float32)


def saying(position):
    return {"action": AHEAD, "prediction": np.asarray(position, dtype=np.float32)}


def test_who_predicts_what_the_filter_estimates_earns_what_the_true_error_pays_a_step_later():
    env = PositionPrediction(
        TrueError(BeliefObservation(gym.make("StereoSlam/Gaze-v0", **QUICK), **BELIEF)), keep_reward=True
    )
    _, info = env.reset(seed=3)
    paid = []
    for _ in range(8):
        owed, position = info["reward_error"], env.get_wrapper_attr("slam").pose.position
        _, reward, *_, info = env.step(saying(position))
        assert info["prediction"]["loss"] == pytest.approx(-owed, abs=1e-5)
        assert info["base_reward"] == info["reward_error"]
        assert reward == pytest.approx(info["base_reward"] - info["prediction"]["loss"])
        paid.append(info["prediction"]["loss"])
    assert paid[0] < 1e-6 < paid[-1]  # the start is known, and then no longer
    env.close()


def test_the_target_is_where_the_camera_was_when_the_prediction_was_made():
    env = PositionPrediction(gym.make("StereoSlam/Gaze-v0", **QUICK))
    _, info = env.reset(seed=3)
    for _ in range(5):
        before = info["truth_position"]
        _, reward, *_, info = env.step(saying(before + np.array([0.0, 0.3, 0.4])))
        np.testing.assert_allclose(info["prediction"]["target"], before, atol=1e-5)
        assert reward == pytest.approx(-0.25, abs=1e-5)
        assert np.linalg.norm(info["truth_position"] - before) > 0.05
    loss = env.loss_fn.numpy(np.ones((2, 3)), np.zeros((2, 3)))
    np.testing.assert_array_equal(loss, [3.0, 3.0])
    assert env.prediction_space.shape == env.prediction_target_space.shape == (3,)
    assert env.inner_action_space == env.unwrapped.action_space
    env.close()


def test_what_is_predicted_does_not_move_the_car_and_a_snapshot_has_it():
    env = PositionPrediction(gym.make("StereoSlam/Gaze-v0", **QUICK))
    env.reset(seed=3)
    kept, ends = snapshot(env), []
    for claim in (np.zeros(3), np.full(3, 1e3), np.zeros(3)):
        restore(env, kept)
        ends.append(env.step(saying(claim)))
    np.testing.assert_array_equal(ends[0][0]["uvd"], ends[1][0]["uvd"])
    assert ends[1][1] < -1e6 < ends[0][1]
    assert ends[0][1] == ends[2][1]
    env.close()


def test_many_are_the_same_as_one():
    seeds = [3, 4]
    vector = gym.make_vec("StereoSlam/Gaze-v0", num_envs=2, prediction={}, **QUICK)
    seen, _ = vector.reset(seed=seeds)
    many = []
    for k in range(4):
        actions = {"action": np.zeros((2, 2), np.float32), "prediction": np.full((2, 3), 0.1 * k, np.float32)}
        assert vector.action_space.contains(actions)
        many.append(vector.step(actions))
    for b, seed in enumerate(seeds):
        env = PositionPrediction(gym.make("StereoSlam/Gaze-v0", **QUICK))
        env.reset(seed=seed)
        for k in range(4):
            seen, reward, *_, info = env.step(saying(np.full(3, 0.1 * k)))
            assert reward == many[k][1][b]
            np.testing.assert_array_equal(seen["uvd"], many[k][0]["uvd"][b])
            np.testing.assert_array_equal(info["prediction"]["target"], many[k][4]["prediction"]["target"][b])
        env.close()
    with pytest.raises(ValueError, match="actions must have the keys action, prediction"):
        vector.step(np.zeros((2, 2)))
    vector.close()
