"""What an agent is trained on."""

import dataclasses
import json

import gymnasium as gym
import numpy as np
import pytest

from stereo_slam_env.benchmark import preset_study
from stereo_slam_env.envs.active_gaze import GazeTask


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
