"""What an agent is trained on."""

import dataclasses
import json
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

from stereo_slam_env.benchmark import preset_study
from stereo_slam_env.envs.active_gaze import POLICY_KEYS, GazeTask


def single(task):
    """One environment of a task."""
    return task.around(gym.make(task.environment, **task.world))


QUICK = {"route": "right-turn"}


def test_a_task_is_json_able_and_read_back():
    task = GazeTask(arguments=QUICK, hold=2, filter="right-invariant")
    assert GazeTask(**json.loads(json.dumps(dataclasses.asdict(task)))) == task


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"hold": 0}, "hold must be a whole number >= 1, got 0"),
        ({"resolution": (0.01, -1.0)}, "resolution must be a finite number > 0, got -1.0"),
        ({"reward": "truth"}, "reward must be one of 'information', 'error', got 'truth'"),
        ({"criterion": "trace"}, "criterion must be one of "),
        ({"pans": 1}, "pans must be a whole number >= 2, got 1"),
    ],
)
def test_a_wrong_value_gets_one_clear_line(wrong, message):
    with pytest.raises(ValueError, match=message):
        GazeTask(**wrong)


def test_an_environment_without_a_head_is_refused():
    with pytest.raises(ValueError, match="that of this environment is fixed: use StereoSlam/Gaze-v0") as error:
        GazeTask("StereoSlam/Drive-v0", QUICK).make()
    assert "\n" not in str(error.value)


def test_benchmark_and_training_have_the_same_filter_in_the_loop():
    (choice,) = preset_study("gaze").cells[0].scenario.filters
    task = GazeTask()
    assert (choice.name, choice.options) == (task.filter, task.filter_options)


def test_a_decision_holds_and_its_rewards_add_up_to_what_was_learnt():
    task = GazeTask(arguments=QUICK, hold=4, pans=None, reward="information")
    env = single(task)
    try:
        observation, info = env.reset(seed=0)
        assert tuple(observation) == POLICY_KEYS
        first, total, steps, over = info["information_potential"], 0.0, 0, False
        while not over:
            observation, reward, over, _, info = env.step(np.array([0.3, 0.0], dtype=np.float32))
            total, steps = total + reward, steps + 1
        assert observation in env.observation_space
        assert steps == 20  # 79 steps of the route
        assert total == pytest.approx(first - info["information_potential"], abs=1e-9)
    finally:
        env.close()


@pytest.mark.parametrize(
    "paid",
    [
        {"reward": "error"},
        {"criterion": "a-optimality"},
        {"belief": "reference"},
        {"nees_gate": 0.95},
    ],
    ids=str,
)
def test_what_is_paid_for_is_the_same_for_one_and_for_many(paid):
    """Rewards of an episode in a vector are those of the single environment, bit for bit."""
    task = GazeTask(arguments=QUICK, hold=8, **paid)
    vector, singles = task.make_vector(2), [single(task) for _ in range(2)]
    try:
        vector.reset(seed=[3, 4])
        for seed, env in zip((3, 4), singles, strict=True):
            env.reset(seed=seed)
        for number in (0, 4, 8, 4):
            rewards = vector.step(np.full(2, number))[1]
            assert rewards.tolist() == [env.step(number)[1] for env in singles]
    finally:
        for env in (vector, *singles):
            env.close()


def test_the_true_error_is_paid_once_a_decision():
    """Minus the squared distance of the filter's position from the truth, after the frames of the decision."""
    env = single(GazeTask(arguments=QUICK, hold=4, pans=None, reward="error"))
    try:
        env.reset(seed=0)
        for _ in range(5):
            _, reward, _, _, info = env.step(np.array([0.3, 0.0], dtype=np.float32))
            error = env.get_wrapper_attr("slam").pose.position - info["truth_position"]
            assert reward == pytest.approx(-(error @ error), rel=1e-12) == info["reward_error"]
            assert reward < 0.0
    finally:
        env.close()


@pytest.mark.parametrize("environment", ["StereoSlam/Gaze-v0", "StereoSlam/DriveGaze-v0"])
def test_a_number_stands_for_a_direction(environment):
    policy = {"policy": "route"} if environment.endswith("DriveGaze-v0") else {}
    task = GazeTask(environment, {**QUICK, **policy, "pan_rate": 100.0}, hold=1, pans=5)
    env = single(task)
    try:
        env.reset(seed=0)
        farthest = env.get_wrapper_attr("options").max_pan
        for number, share in [(0, -1.0), (3, 0.5), (2, 0.0), (4, 1.0)]:
            env.step(number)
            np.testing.assert_allclose(env.get_wrapper_attr("head_angles"), [share * farthest, 0.0], atol=1e-6)
    finally:
        env.close()


def test_the_task_has_an_id_and_can_be_copied():
    env = gym.make("StereoSlam/ActiveGaze-v0", arguments=QUICK)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    results = []
    for made in (env, again, pickle.loads(pickle.dumps(env))):
        observation, _ = made.reset(seed=3)
        steps = [made.step(number) for number in (0, 4, 8)]
        results.append([observation, *[step[:4] for step in steps]])
        made.close()
    assert data_equivalence(results[0], results[1], exact=True)
    assert data_equivalence(results[0], results[2], exact=True)
    with pytest.raises(TypeError, match="unexpected keyword argument 'holds'"):
        gym.make("StereoSlam/ActiveGaze-v0", holds=3)


def test_the_task_passes_the_checker():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version")
        check_env(gym.make("StereoSlam/ActiveGaze-v0", arguments=QUICK, disable_env_checker=True))
